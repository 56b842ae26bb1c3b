"""OpenVINO's `Core`, once for the whole process."""

from __future__ import annotations

import threading
from functools import cache

import openvino as ov

_lock = threading.Lock()


def core() -> ov.Core:
    """The only one, kept to the end of the process.

    On processors with matrix units each `Core` gives the thread that makes it a stack for signals, and gives the thread
    that drops it what the first one had before. With several of them, or several threads, that stack may be gone: the
    next signal that Python handles, such as Ctrl-C, would kill the process with a segmentation fault.
    """
    with _lock:
        return _made()


@cache
def _made() -> ov.Core:
    return ov.Core()
