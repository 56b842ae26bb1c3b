"""Bundle adjustment of lines: SciPy's trust region moves the poses, and every line follows them to where it fits best.

Once the poses are given, lines do not depend on each other: each has four degrees of freedom and Gauss-Newton steps of
its own (`fit_lines`). So the poses alone are left to the optimiser (variable projection, Golub and Pereyra 1973), with
the Schur complement as their Hessian. Distances in the image count by Huber's loss.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from line_odometry.geometry import Array, move_lines, move_poses, slopes
from line_odometry.views import Observations

HUBER = 1.0  # px
DAMPING = 1e-6  # of the equations: what no observation fixes stays where it is
FIRST_RADIUS = 0.3  # of the trust region: radians, and units of the world


def costs(seen: Observations, lines: Array, poses: Array) -> Array:
    """(N,) Huber's loss of each line's end points, px^2: half the square of a distance, and beyond 1 px linear."""
    size = np.abs(seen.errors(lines, poses))
    return seen.sums(np.where(size < HUBER, 0.5 * size**2, HUBER * (size - 0.5 * HUBER)).sum(axis=1))


@dataclass(frozen=True)
class Equations:
    """Gauss-Newton's equations, with Huber's weights.

    Attributes:
        hessian, gradient: (N, 4, 4) and (N, 4) of each line.
        by_pose, by_line: (M, 2, 6) and (M, 2, 4) derivatives of the weighted distances.
        errors: (M, 2) weighted distances, px.
    """

    hessian: Array
    gradient: Array
    by_pose: Array
    by_line: Array
    errors: Array

    @staticmethod
    def at(seen: Observations, lines: Array, poses: Array) -> Equations:
        """The equations at the given lines and poses."""
        errors, by_pose, by_line = (seen.focal * part for part in slopes(seen.ends, lines[seen.line], poses[seen.view]))
        weight = np.sqrt(HUBER / np.maximum(np.abs(errors), HUBER))
        errors, by_pose, by_line = weight * errors, weight[:, :, None] * by_pose, weight[:, :, None] * by_line
        hessian = seen.sums(by_line.transpose(0, 2, 1) @ by_line)
        hessian += (DAMPING * np.einsum("nii->ni", hessian) + 1e-12)[:, :, None] * np.eye(4)
        return Equations(hessian, seen.sums((errors[:, None] @ by_line)[:, 0]), by_pose, by_line, errors)


def fit_lines(seen: Observations, lines: Array, poses: Array, steps: int) -> Array:
    """The lines (N, 2, 3) after Gauss-Newton steps under fixed poses; a step that makes its line worse is not taken."""
    cost = costs(seen, lines, poses)
    for _ in range(steps):
        system = Equations.at(seen, lines, poses)
        step = -np.linalg.solve(system.hessian, system.gradient[:, :, None])[:, :, 0]
        for share in (1.0, 0.2):
            moved = move_lines(lines, share * step)
            after = costs(seen, moved, poses)
            better = after < cost
            lines, cost = np.where(better[:, None, None], moved, lines), np.where(better, after, cost)
            step[better] = 0
            if better.all():
                break
    return lines


def adjust(seen: Observations, lines: Array, poses: Array, free: NDArray[np.bool_], steps: int) -> tuple[Array, Array]:
    """Lines and poses that agree with what was seen.

    Args:
        seen: the observations.
        lines: (N, 2, 3) to start from.
        poses: (K, 3, 4) to start from.
        free: (K,) whether a pose may move; one at least must not, for it holds the world.
        steps: of the optimiser, at most.

    Returns:
        Lines and poses, of the same shapes.
    """
    problem = _Poses(seen, lines, poses, np.flatnonzero(free))
    found = minimize(
        problem.cost,
        np.zeros(6 * int(free.sum())),
        jac=problem.gradient,
        hess=lambda x: problem.hessian,
        method="trust-exact",
        options={"maxiter": steps, "initial_trust_radius": FIRST_RADIUS, "gtol": 1e-3},
    )
    problem.cost(found.x)
    return problem.lines, problem.moved(found.x)


class _Poses:
    """The cost of poses when every line is where it fits them best.

    The optimiser asks for the gradient only where it has just asked for the cost, and for the Hessian only where it has
    just asked for the gradient, so each goes on from what was found before. Lines start from where they were last.
    """

    def __init__(self, seen: Observations, lines: Array, poses: Array, free: NDArray[np.intp]) -> None:
        self.lines = lines
        self._seen, self._poses, self._free = seen, poses, free
        column = np.full(len(poses), -1)
        column[free] = np.arange(len(free))
        self._own = np.flatnonzero(column[seen.view] >= 0)
        self._column = column[seen.view[self._own]]

    def moved(self, x: Array) -> Array:
        """(K, 3, 4) the poses after a change."""
        change = np.zeros((len(self._poses), 6))
        change[self._free] = x.reshape(-1, 6)
        return move_poses(self._poses, change)

    def cost(self, x: Array) -> float:
        """Huber's loss, px^2."""
        poses = self.moved(x)
        self.lines = fit_lines(self._seen, self.lines, poses, steps=2)
        return float(costs(self._seen, self.lines, poses).sum())

    def gradient(self, x: Array) -> Array:
        """(6F,) by the changes of the free poses; also solves for the lines' part of the (6F, 6F) `hessian`."""
        system = Equations.at(self._seen, self.lines, self.moved(x))
        n, own = len(self._free), self._own
        turned = system.by_pose[own].transpose(0, 2, 1)
        gradient, blocks = np.zeros((n, 6)), np.zeros((n, 6, 6))
        np.add.at(gradient, self._column, (turned @ system.errors[own][:, :, None])[:, :, 0])
        np.add.at(blocks, self._column, turned @ system.by_pose[own])
        cross = np.zeros((len(self.lines), n, 6, 4))
        np.add.at(cross, (self._seen.line[own], self._column), turned @ system.by_line[own])
        cross = cross.reshape(len(self.lines), 6 * n, 4)
        solved = np.linalg.solve(system.hessian, cross.transpose(0, 2, 1))
        hessian = np.zeros((n, 6, n, 6))
        hessian[np.arange(n), :, np.arange(n)] = blocks + DAMPING * np.eye(6)
        flat = cross.transpose(1, 0, 2).reshape(6 * n, -1), solved.reshape(-1, 6 * n)
        self.hessian = hessian.reshape(6 * n, 6 * n) - flat[0] @ flat[1]
        return gradient.ravel() - system.gradient.ravel() @ flat[1]
