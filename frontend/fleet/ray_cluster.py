"""Workers on a Ray cluster."""

from __future__ import annotations

import logging
import os
import socket
from typing import Any

from airline.errors import ConfigError, InputError
from frontend.fleet.job import Job, Recipe, Row, run_job
from frontend.fleet.workers import Died

_MOST = 1000  # recordings that Ray has to keep in mind at once
_OBJECT_STORE_BYTES = 80 * 2**20  # Ray's least: rows are all that it carries
_TIMEOUT_S = 10.0


class RayWorkers:
    """Tasks of one CPU each; see `Workers`. Recordings and results are on a file system that all nodes share.

    Args:
        address: "local" starts Ray on this machine, for this machine alone; "auto", HOST:PORT and ray://HOST:PORT
            connect to a cluster, whose nodes have this package installed.
        recipe: what is done with each recording.

    Raises:
        ConfigError: Ray is not installed.
        InputError: there is no cluster at that address.
    """

    def __init__(self, address: str, recipe: Recipe) -> None:
        self._ray = _import_ray()
        self._ours = not self._ray.is_initialized()
        if self._ours:
            _connect(self._ray, address)
        # Ray's own retries would go on for ever where memory runs out
        self._task = self._ray.remote(num_cpus=1, max_retries=0)(run_job)
        self._recipe = recipe
        self._running: dict[Any, Job] = {}

    def has_room(self) -> bool:
        """Whether another recording can be started."""
        return len(self._running) < _MOST

    def start(self, job: Job) -> None:
        """Start a recording, or let it wait for a CPU."""
        self._running[self._task.remote(job, self._recipe)] = job

    def wait(self) -> list[tuple[Job, Row | Died]]:
        """Wait until recordings have ended, one at least."""
        return [(self._running.pop(task), self._result(task)) for task in self._ray.wait(list(self._running))[0]]

    def close(self) -> None:
        """End what is running, and leave the cluster."""
        for task in self._running:
            self._ray.cancel(task, force=True)
        self._running.clear()
        if self._ours:
            self._ray.shutdown()

    def _result(self, task: Any) -> Row | Died:
        try:
            row: Row = self._ray.get(task)
        except self._ray.exceptions.RayTaskError as error:  # such as a node without this package
            return Died(f"its Ray task failed with {_first_line(error.cause or error)}")
        except self._ray.exceptions.RayError as error:
            return Died(f"its Ray worker ended: {_first_line(error)}")
        return row


def _import_ray() -> Any:
    """Ray, told to be quiet and to stay on this machine; what the user has set comes first."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # tasks see the GPU
    os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # a Ray that we start binds to 127.0.0.1
    try:
        import ray
    except ImportError:
        raise ConfigError("--ray needs Ray: pip install 'airline-frontend[fleet]'") from None
    return ray


def _connect(ray: Any, address: str) -> None:
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if address == "local":
        options |= {"include_dashboard": False, "object_store_memory": _OBJECT_STORE_BYTES}
        options |= {"_node_ip_address": "127.0.0.1"}
    elif address != "auto":
        _check_reachable(address)
    try:
        ray.init(address, **options)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        raise InputError(f"cannot use Ray at '{address}': {_first_line(error)}") from None


def _check_reachable(address: str) -> None:
    """Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdecimal() and int(port) < 2**16):
        raise ConfigError(f"'{address}' is no address of Ray: give local, auto, HOST:PORT or ray://HOST:PORT")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _TIMEOUT_S).close()
    except OSError as error:
        raise InputError(f"no Ray cluster answers at '{address}' ({error.strerror or error}): start one") from None


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return ": ".join([type(error).__name__, *lines[:1]]).rstrip(".")
