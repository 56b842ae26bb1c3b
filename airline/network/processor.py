"""What the processor multiplies fastest."""

from __future__ import annotations

import os
from functools import cache

import llvmlite.binding

from airline.network.native.vectors import AVX2, AVX2_VNNI, AVX512_VNNI, Isa


def has_amx() -> bool:
    """Whether it multiplies matrices of bfloat16 numbers."""
    return _has("amx-bf16") and _allowed("AMX")


def has_bf16() -> bool:
    """Whether it multiplies bfloat16 numbers; OpenVINO also offers to imitate it, three times slower than float32."""
    other_than_x86 = not _has("sse2")  # there OpenVINO is believed
    return other_than_x86 or has_amx() or (_has("avx512bf16") and _allowed("BF16", "FP16", "AMX"))


def has_vnni() -> bool:
    """Whether it multiplies and adds 8-bit numbers in one instruction, as most x86 laptops have since 2020."""
    return (_has("avx512vnni") or _has("avxvnni")) and _allowed("VNNI", "BF16", "FP16", "AMX")


def vector_instructions() -> Isa | None:
    """Which of its vector instructions the runtime "native" uses; None where it has none of them."""
    if has_vnni():
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
