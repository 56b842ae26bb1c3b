"""Which instructions the processor has, for the choice of a runtime and within it."""

from __future__ import annotations

import os
from functools import cache

import llvmlite.binding

# Numba compiles anew for tuples of other lengths. The first one's is the number of 32-bit lanes; the second one is
# empty without VNNI, whose instructions multiply and add at once: then the sum of two products has to fit into 16 bits,
# and weights have 7.
Isa = tuple[tuple[int, ...], tuple[int, ...]]
AVX512_VNNI: Isa = ((0,) * 16, (0,))
AVX2_VNNI: Isa = ((0,) * 8, (0,))
AVX2: Isa = ((0,) * 8, ())


def has_bf16() -> bool:
    """Whether it multiplies bfloat16 numbers; OpenVINO also offers to imitate it, three times slower than float32."""
    if not _has("sse2"):  # other than x86, where OpenVINO is believed
        return True
    return (_has("amx-bf16") and _allowed("AMX")) or (_has("avx512bf16") and _allowed("BF16", "FP16", "AMX"))


def vector_instructions() -> Isa | None:
    """Which of its SIMD instructions the runtime "native" uses; None where it has none of them."""
    if (_has("avx512vnni") or _has("avxvnni")) and _allowed("VNNI", "BF16", "FP16", "AMX"):
        wide = _has("avx512vnni") and _has("avx512bw") and _allowed("AVX512", "AVX10")
        return AVX512_VNNI if wide else AVX2_VNNI
    return AVX2 if _has("avx2") and _has("fma") and _allowed("AVX") else None


@cache
def _has(feature: str) -> bool:
    return bool(llvmlite.binding.get_host_cpu_features().get(feature, False))


def _allowed(*parts: str) -> bool:
    """Whether oneDNN, and so OpenVINO, may use it: the variable makes a new processor pass for an old one."""
    limit = os.environ.get("ONEDNN_MAX_CPU_ISA", "ALL").upper()
    return limit in ("ALL", "DEFAULT") or any(part in limit for part in parts)
