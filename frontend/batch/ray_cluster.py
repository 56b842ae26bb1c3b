"""Recordings as tasks on a Ray cluster, one CPU each."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from airline.errors import ConfigError, InputError, from_extra
from frontend.batch.job import Job, JobSettings, run_recording

if TYPE_CHECKING:
    from frontend.batch import Submit

_OBJECT_STORE_BYTES = 80 * 2**20  # Ray's least: rows are all that it carries
_TIMEOUT_S = 10.0


@contextmanager
def on_ray(address: str, settings: JobSettings) -> Iterator[Submit]:
    """What starts recordings; at the end of the block, those that still run are ended.

    The address "local" starts Ray on this machine, for this machine alone; "auto", HOST:PORT and ray://HOST:PORT
    connect to a cluster, whose nodes have this package, and inputs and results under the same paths.

    Raises:
        ConfigError: Ray is not installed, or that is no address.
        InputError: there is no cluster at that address.
    """
    # Ray is told to be quiet and to stay on this machine; what the user has set comes first
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # tasks see the GPU
    os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")  # a Ray that we start binds to 127.0.0.1
    with from_extra("fleet"):
        import ray
    ours = not ray.is_initialized()
    if ours:
        _connect(ray, address)
    task = ray.remote(num_cpus=1, max_retries=0)(run_recording)  # Ray's retries would go on for ever without memory
    started = []

    def submit(job: Job) -> Any:
        started.append(task.remote(job, settings))
        return started[-1].future()

    try:
        yield submit
    finally:
        for result in started:
            ray.cancel(result, force=True)  # of no effect on what has ended
        if ours:
            ray.shutdown()


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
        reason = ": ".join([type(error).__name__, *str(error).strip().splitlines()[:1]]).rstrip(".")
        raise InputError(f"cannot use Ray at '{address}': {reason}") from None


def _check_reachable(address: str) -> None:
    """Ray itself would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdecimal() and int(port) < 2**16):
        raise ConfigError(f"'{address}' is no address of Ray: give local, auto, HOST:PORT or ray://HOST:PORT")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _TIMEOUT_S).close()
    except OSError as error:
        raise InputError(f"no Ray cluster answers at '{address}' ({error.strerror or error}): start one") from None
