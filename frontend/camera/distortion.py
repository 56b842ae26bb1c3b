"""Lens distortion and its inverse, exact to the last bits of float32 wherever the model makes sense.

A lens moves a point at radius r to r N(r^2) / D(r^2): for the radial-tangential model (Brown 1966; the rational form is
OpenCV's) r is the radius on the plane z = 1, for the equidistant fisheye (Kannala and Brandt 2006) it is the angle
from the axis in radians. Where that function stops rising the image folds back on itself: no point out there can be
told from one further in, and the answer is NaN.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

Array = NDArray[np.float64]
Profile = tuple[tuple[float, ...], tuple[float, ...]]  # coefficients of N and D in r^2, lowest first

_WIDEST = 1e3  # radius on the plane z = 1, 89.94 degrees off the axis
_NEGLIGIBLE = 1e-12  # leading coefficients of polynomials in r^2
_ITERATIONS = 60
_quiet = np.errstate(all="ignore")  # infinities and NaN are answers here
_RESIDUAL = 1e-9  # on the distorted plane; a thousandth of float32's step at pixel 1000 and focal length 500 px


@_quiet
def distort_radial_tangential(plane: Array, coefficients: Array) -> Array:
    """Where the lens moves points of the plane z = 1.

    Args:
        plane: (N, 2) undistorted.
        coefficients: k1, k2, p1, p2[, k3[, k4, k5, k6]].

    Returns:
        (N, 2) distorted; NaN outside of the model's domain.
    """
    profile, p1, p2 = _radial_tangential(coefficients)
    distorted, (a, b, c) = _move(plane, profile, p1, p2)
    inside = (np.hypot(plane[:, 0], plane[:, 1]) < min(_limit(profile), _WIDEST)) & (a * c > b * b)
    return np.where(inside[:, None], distorted, np.nan)


@_quiet
def undistort_radial_tangential(distorted: Array, coefficients: Array) -> Array:
    """The inverse of `distort_radial_tangential`; NaN where no point of its domain is moved to."""
    profile, p1, p2 = _radial_tangential(coefficients)
    radius = np.hypot(distorted[:, 0], distorted[:, 1])
    if (p1 or p2) and (
        limit := _limit(profile)
    ) < np.inf:  # the tangential part moves some points beyond the radial one
        radius = np.minimum(radius, _value(profile, np.array(0.99 * limit))[0])
    plane = _rescaled(distorted, _invert(profile, radius, _WIDEST))
    if p1 or p2:
        for _ in range(_ITERATIONS):  # Newton; the radial part alone is a close start
            moved, (a, b, c) = _move(plane, profile, p1, p2)
            x, y = (moved - distorted).T
            if not (np.abs(x) + np.abs(y) > 1e-12).any():
                break
            plane = plane - np.stack([c * x - b * y, a * y - b * x], axis=1) / (a * c - b * b)[:, None]
    error = np.abs(distort_radial_tangential(plane, coefficients) - distorted).max(axis=1, initial=0)
    return np.where((error < _RESIDUAL)[:, None], plane, np.nan)


@_quiet
def distort_equidistant(plane: Array, coefficients: Array) -> Array:
    """Where a fisheye moves points (N, 2) of the plane z = 1; k1..k4. NaN outside of the model's domain."""
    profile = _equidistant(coefficients)
    angle = np.arctan(np.hypot(plane[:, 0], plane[:, 1]))
    moved = np.where(angle < _limit(profile), _value(profile, angle)[0], np.nan)
    return _rescaled(plane, moved)


@_quiet
def undistort_equidistant(distorted: Array, coefficients: Array) -> Array:
    """The inverse of `distort_equidistant`; NaN also for what lies 90 degrees and more off the axis."""
    angle = _invert(_equidistant(coefficients), np.hypot(distorted[:, 0], distorted[:, 1]), np.pi / 2)
    return _rescaled(distorted, np.tan(angle))


def _radial_tangential(coefficients: Array) -> tuple[Profile, float, float]:
    k1, k2, p1, p2, k3, *rational = [*map(float, coefficients), *[0.0] * (8 - len(coefficients))]
    return ((1.0, k1, k2, k3), (1.0, *rational)), p1, p2


def _equidistant(coefficients: Array) -> Profile:
    return (1.0, *map(float, coefficients)), (1.0,)


def _rescaled(points: Array, radius: Array) -> Array:
    """`points` (N, 2) at new radii (N,); the origin stays."""
    old = np.hypot(points[:, 0], points[:, 1])
    return np.asarray(points * np.divide(radius, old, out=np.ones_like(old), where=old != 0)[:, None])


def _value(profile: Profile, radius: Array) -> tuple[Array, Array]:
    """r N(r^2) / D(r^2) and its derivative by r."""
    s = np.square(radius)
    (n, dn), (d, dd) = (_horner(p, s) for p in profile)
    return radius * n / d, n / d + 2 * s * (dn * d - n * dd) / np.square(d)


def _horner(coefficients: tuple[float, ...], s: Array) -> tuple[Array, Array]:
    """A polynomial and its derivative; numpy's are several times slower on a few hundred points."""
    value, slope = np.full_like(s, coefficients[-1]), np.zeros_like(s)
    for coefficient in coefficients[-2::-1]:
        slope = slope * s + value
        value = value * s + coefficient
    return value, slope


@lru_cache(maxsize=64)
def _limit(profile: Profile) -> float:
    """Radius up to which the profile rises: the first zero of its derivative or of D; inf if there is none."""
    n, d = map(np.asarray, profile)
    curl = polynomial.polysub(
        polynomial.polymul(polynomial.polyder(n), d), polynomial.polymul(n, polynomial.polyder(d))
    )
    slope = polynomial.polyadd(polynomial.polymul(n, d), polynomial.polymul([0.0, 2.0], curl))
    roots = np.concatenate([polynomial.polyroots(polynomial.polytrim(p, _NEGLIGIBLE)) for p in (slope, d)])
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
    return float(np.sqrt(real.min())) if len(real) else np.inf


def _invert(profile: Profile, target: Array, widest: float) -> Array:
    """Radii (N,) below `widest` that the profile moves to `target`: Newton's method inside a shrinking bracket."""
    limit = min(_limit(profile), widest)
    low, high = np.zeros_like(target), np.full_like(target, limit)
    radius = np.minimum(target, 0.5 * limit)
    for _ in range(_ITERATIONS):
        value, slope = _value(profile, radius)
        low, high = np.where(value <= target, radius, low), np.where(value <= target, high, radius)
        refined = radius - (value - target) / slope
        refined = np.where((refined >= low) & (refined <= high), refined, 0.5 * (low + high))
        moved = np.abs(refined - radius)
        radius = refined
        if not (moved > 1e-12 * radius).any():
            break
    error = np.abs(_value(profile, radius)[0] - target)
    return np.where((error < _RESIDUAL) & (radius < limit), radius, np.nan)


def _move(plane: Array, profile: Profile, p1: float, p2: float) -> tuple[Array, tuple[Array, Array, Array]]:
    """Radial and tangential distortion of (N, 2) points, and the entries xx, xy = yx, yy (N,) of its Jacobian."""
    x, y = plane.T
    s = x * x + y * y
    value, slope = _value(profile, np.sqrt(s))
    gain = np.divide(value, np.sqrt(s), out=np.ones_like(s), where=s > 0)
    bend = np.divide(slope - gain, s, out=np.zeros_like(s), where=s > 0)  # the gain's gradient is bend (x, y)
    moved_x = x * gain + 2 * p1 * x * y + p2 * (s + 2 * x * x)
    moved_y = y * gain + p1 * (s + 2 * y * y) + 2 * p2 * x * y
    xx = gain + x * x * bend + 2 * p1 * y + 6 * p2 * x
    xy = x * y * bend + 2 * p1 * x + 2 * p2 * y
    yy = gain + y * y * bend + 6 * p1 * y + 2 * p2 * x
    return np.stack([moved_x, moved_y], axis=1), (xx, xy, yy)
