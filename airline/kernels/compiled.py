"""numba's `njit` with a cache that notices every change, and that costs only time where it cannot be kept."""

from __future__ import annotations

import hashlib
import logging
import re
import shutil
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache

log = logging.getLogger(__name__)

# The same for every function: what two of them call with the same types, such as `np.empty`, is then compiled once.
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
KEPT = 2  # folders of earlier sources that stay, for who goes back and forth between them

_warned = False


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with `OPTIONS`, more of them, and a cache; where there is no folder for it, a warning.

    Fast-math functions are inlined into their callers: LLVM orders the sums of each copy in its own way, and which copy
    a process calls would depend on whether it has compiled it or found it in the cache.
    """

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**{**OPTIONS, "forceinline": "fastmath" in options, **options})(function)
        try:
            dispatcher._cache = _Cache(function)  # type: ignore[no-untyped-call]
        except RuntimeError as error:  # neither beside the source nor in the home folder
            if "no locator available" not in str(error):
                raise
            _warn("there is no folder to keep it in")
        return dispatcher

    return compiled


class _Location(CompileResultCacheImpl):
    """numba's folder for a function, and in it one for all sources as they are now.

    numba notices changes of a function's own file, but not of functions in other files that are compiled into it.
    """

    def __init__(self, function: Any) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        own = (function.__globals__.get("__package__") or "").partition(".")[0]
        sources = "-".join(_digest(package) for package in sorted({"airline", own} - {""}))
        self._locator._cache_path = str(Path(self._locator.get_cache_path()) / f"kernels-{sources}")


class _Cache(FunctionCache):
    """Reading what is damaged gives nothing, so that it is compiled anew; what cannot be written is not kept."""

    _impl_class = _Location

    def load_overload(self, *arguments: Any) -> Any:
        try:
            return super().load_overload(*arguments)  # type: ignore[no-untyped-call]
        except Exception as error:  # whatever unpickling a damaged file raises
            _warn(f"{type(error).__name__}: {error}")
            return None

    def save_overload(self, *arguments: Any) -> None:
        try:
            folder = Path(self.cache_path)
            if not folder.exists():
                others = sorted(folder.parent.glob("kernels-*"), key=lambda path: path.stat().st_mtime)
                for old in others[:-KEPT]:
                    shutil.rmtree(old, ignore_errors=True)
            super().save_overload(*arguments)  # type: ignore[no-untyped-call]
        except Exception as error:
            _warn(f"{type(error).__name__}: {error}")


@cache
def _digest(package: str) -> str:
    """Of a package's sources that use numba, and of those that they import, whose constants are compiled in."""
    sources = {}
    for root in map(Path, getattr(sys.modules.get(package), "__path__", ())):
        for path in sorted(root.rglob("*.py")):
            sources[".".join((package, *path.relative_to(root).with_suffix("").parts))] = path.read_bytes()
    kernels = {name for name, source in sources.items() if b"numba" in source or b"njit" in source}
    imported = {name.decode() for kernel in kernels for name in re.findall(rb"from ([\w.]+) import", sources[kernel])}
    digest = hashlib.sha256()
    for name in sorted(kernels | imported & sources.keys()):
        digest.update(sources[name])
    return digest.hexdigest()[:12]


def _warn(why: str) -> None:
    global _warned
    if not _warned:
        _warned = True
        log.warning(
            "compiled code cannot be kept (%s), so every start takes half a minute longer: "
            "set NUMBA_CACHE_DIR to a folder that can be written to",
            why,
        )
