"""SIMD instructions as LLVM knows them.

A map is laid out in groups of four channels: each group is a plane of pixels with four bytes each, so that one vector
holds a group of 8 or 16 neighbouring pixels, and one instruction multiplies and adds the four channels of all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils

I8, I16, I32, I64, F32 = ir.IntType(8), ir.IntType(16), ir.IntType(32), ir.IntType(64), ir.FloatType()

TILE = 16  # pixels that are treated at once, in one vector or two


class Vectors:
    """Emits instructions on whole vectors; addresses and values are those of LLVM."""

    def __init__(self, builder: Any, isa: Any) -> None:
        """For a builder, and numba's type of a `processor.Isa`."""
        lanes, fused = isa
        self.builder, self.lanes, self.fused = builder, len(lanes), bool(len(fused))
        self.size, self.count = 4 * self.lanes, TILE // self.lanes  # bytes of a vector, vectors of a tile
        self.totals = 16 if self.lanes == 16 else 8  # that leave enough of 32 or 16 registers
        self.ints = ir.VectorType(I32, self.lanes)
        self.floats = ir.VectorType(F32, self.lanes)
        self.half_of_floats = ir.VectorType(F32, self.lanes // 2)
        self.words = ir.VectorType(I16, 2 * self.lanes)
        self.chars = ir.VectorType(I8, 4 * self.lanes)

    def after(self, address: Any, size: int) -> Any:
        """An address so many bytes further."""
        return self.builder.add(address, I64(size))

    def load(self, address: Any, kind: Any) -> Any:
        return self.builder.load(self.builder.inttoptr(address, kind.as_pointer()), align=1)

    def store(self, value: Any, address: Any) -> None:
        self.builder.store(value, self.builder.inttoptr(address, value.type.as_pointer()), align=1)

    def slot(self) -> Any:
        """A place for integers, zeros at first; LLVM makes a register of it."""
        return cgutils.alloca_once_value(self.builder, self.ints(None))  # type: ignore[no-untyped-call]

    def splat(self, scalar: Any) -> Any:
        """A scalar in every lane."""
        kind = ir.VectorType(scalar.type, self.lanes)
        one = self.builder.insert_element(kind(ir.Undefined), scalar, I32(0))
        return self.pick(one, one, [0] * self.lanes)

    def pick(self, first: Any, second: Any, order: Sequence[int]) -> Any:
        """Lanes of two vectors, by their numbers."""
        return self.builder.shuffle_vector(first, second, ir.VectorType(I32, len(order))(list(order)))

    def greater(self, a: Any, b: Any) -> Any:
        """The greater of unsigned numbers."""
        return self.builder.select(self.builder.icmp_unsigned(">", a, b), a, b)

    def byte(self, ints: Any, number: int) -> Any:
        """Byte 0 to 3 of each lane."""
        shift, mask = (self.ints([value] * self.lanes) for value in (8 * number, 255))
        return self.builder.and_(self.builder.lshr(ints, shift), mask)

    def multiply_add(self, a: Any, b: Any, c: Any) -> Any:
        """a * b + c of floats."""
        return self._call(f"llvm.fma.v{self.lanes}f32", self.floats, a, b, c)

    def dot_bytes(self, total: Any, pixels: Any, weights: Any) -> Any:
        """Sums of four products of unsigned and signed bytes, added to the totals."""
        if self.fused:
            return self._call(f"llvm.x86.avx512.vpdpbusd.{32 * self.lanes}", self.ints, total, pixels, weights)
        pixels, weights = (self.builder.bitcast(each, self.chars) for each in (pixels, weights))
        pairs = self._call("llvm.x86.avx2.pmadd.ub.sw", self.words, pixels, weights)
        return self._dot(total, pairs, self.words([1] * 2 * self.lanes))

    def dot_words(self, total: Any, pixels: Any, weights: Any) -> Any:
        """Sums of two products of signed 16-bit numbers, added to the totals."""
        if self.fused:
            return self._call(f"llvm.x86.avx512.vpdpwssd.{32 * self.lanes}", self.ints, total, pixels, weights)
        return self._dot(total, *(self.builder.bitcast(each, self.words) for each in (pixels, weights)))

    def bytes_of(self, channels: Sequence[Any]) -> Any:
        """Four vectors of floats, one per channel, cut to unsigned bytes, those of a pixel together; saturated."""
        a, b, c, d = (self.builder.fptosi(channel, self.ints) for channel in channels)
        family, suffix = ("avx512", ".512") if self.lanes == 16 else ("avx2", "")
        ab, cd = (self._call(f"llvm.x86.{family}.packssdw{suffix}", self.words, *pair) for pair in ((a, b), (c, d)))
        packed = self._call(f"llvm.x86.{family}.packuswb{suffix}", self.chars, ab, cd)
        # these instructions treat each 128 bits alone
        order = [16 * (k // 16) + 4 * (k % 4) + k % 16 // 4 for k in range(4 * self.lanes)]
        return self.pick(packed, packed, order)

    def _dot(self, total: Any, pixels: Any, weights: Any) -> Any:
        return self.builder.add(total, self._call("llvm.x86.avx2.pmadd.wd", self.ints, pixels, weights))

    def _call(self, name: str, answer: Any, *operands: Any) -> Any:
        module = self.builder.module
        kind = ir.FunctionType(answer, [operand.type for operand in operands])
        return self.builder.call(module.globals.get(name) or ir.Function(module, kind, name), operands)
