"""numba's `njit`, for machines where compiled code cannot be kept: no folder, a full disk, damaged files."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numba

log = logging.getLogger(__name__)

# The same for every function: what two of them call with the same types, such as `np.empty`, is then compiled once.
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}

_warned = False


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with `OPTIONS`, more of them, and a cache.

    A cache that cannot be used costs a warning and time, and nothing else.
    """
    options = {**OPTIONS, **options}

    def compiled(function: Callable[..., Any]) -> Any:
        try:
            dispatcher = numba.njit(cache=True, **options)(function)
        except RuntimeError as error:  # neither beside the source nor in the home folder
            if "no locator available" not in str(error):
                raise
            _warn("there is no folder to keep it in")
            return numba.njit(**options)(function)
        cache = dispatcher._cache
        cache.load_overload = _forgiving(cache.load_overload)
        cache.save_overload = _forgiving(cache.save_overload)
        return dispatcher

    return compiled


def _forgiving(use: Callable[..., Any]) -> Callable[..., Any]:
    """Reading what is damaged gives nothing, so that it is compiled anew; what cannot be written is not kept."""

    def attempt(*arguments: Any) -> Any:
        try:
            return use(*arguments)
        except Exception as error:  # whatever unpickling a damaged file raises
            _warn(f"{type(error).__name__}: {error}")
            return None

    return attempt


def _warn(why: str) -> None:
    global _warned
    if not _warned:
        _warned = True
        log.warning(
            "compiled code cannot be kept (%s), so every start takes half a minute longer: "
            "set NUMBA_CACHE_DIR to a folder that can be written to",
            why,
        )
