"""What is done to `TILE` neighbouring pixels at once, in SIMD instructions; numba compiles it into its callers.

A map is laid out in groups of four channels: each group is a plane of pixels with four bytes each, so that one vector
holds a group of 8 or 16 neighbouring pixels, and one instruction multiplies and adds the four channels of all of them.

All arguments but `isa`, `kind` and operands are addresses and counts, int64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types

from airline.kernels.atomics import intrinsic

I8, I16, I32, I64, F32 = ir.IntType(8), ir.IntType(16), ir.IntType(32), ir.IntType(64), ir.FloatType()

TILE = 16  # pixels that are treated at once, in one vector or two


class Vectors:
    """Emits instructions on whole vectors; addresses and values are those of LLVM."""

    def __init__(self, builder: Any, isa: Any) -> None:
        """For a builder, and numba's type of a `runtimes.Isa`."""
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


Dot = Callable[[Any, Any, Any], Any]
BLOCK = 8  # outputs of a tile, but for the last layer's
PIXEL = 4  # bytes of a group, or of a float

# Kinds of answer: as many numbers as outputs, and whether they become bytes. Numba compiles anew for tuples of other
# lengths, as for `airline.network.runtimes.Isa`.
BYTES, FLOATS, LOGITS = ((0,) * BLOCK, (0,)), ((0,) * BLOCK, ()), ((0,) * 4, ())


@intrinsic
def tile(context, isa, kind, of_bytes, pixels, of_words, words, offsets, target, apart):  # type: ignore[no-untyped-def]
    """Answer some channels of a convolution.

    Args:
        of_bytes: addresses and count of a tuple: terms, int64 bytes from the pixels to each group that counts; count
            of them; weights, (count, outputs, 4 bytes); factors, (outputs,) float32 from totals to answers.
        pixels: in bytes.
        of_words, words: the same of pixels in 16-bit numbers whose products are added; () for none.
        offsets: (outputs,) float32.
        target: where the answers go, as bytes or as floats.
        apart: from a group, or from a channel of floats, to the next, bytes.
    """
    outputs, to_bytes = (len(part) for part in kind)

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        v = Vectors(builder, isa)
        *_, offsets, target, apart = arguments
        for few in _portions(v, outputs):
            answers = _splats(v, few, offsets)
            for dot, operands, place in ((v.dot_words, *arguments[4:6]), (v.dot_bytes, *arguments[2:4])):
                if operands.type.elements:
                    terms, count, weights, factors = cgutils.unpack_tuple(builder, operands)  # type: ignore[no-untyped-call]
                    totals = _totals(v, dot, few, outputs, place, terms, count, weights)
                    answers = _answers(v, few, totals, factors, answers)
            target = _store(v, answers, target, apart, bool(to_bytes))
        return context.get_dummy_value()

    return types.void(isa, kind, of_bytes, types.int64, of_words, *[types.int64] * 4), emit


def _portions(v: Vectors, outputs: int) -> list[range]:
    """Outputs for which the registers last at a time."""
    at_once = v.totals // v.count
    return [range(first, min(first + at_once, outputs)) for first in range(0, outputs, at_once)]


def _totals(
    v: Vectors, dot: Dot, few: range, outputs: int, source: Any, terms: Any, count: Any, weights: Any
) -> list[list[Any]]:
    """By output and vector."""
    builder = v.builder
    slots = [[v.slot() for _ in range(v.count)] for _ in few]
    with cgutils.for_range(builder, count) as loop:
        place = builder.add(source, v.load(builder.add(terms, builder.mul(loop.index, I64(8))), I64))
        pixels = [v.load(v.after(place, v.size * k), v.ints) for k in range(v.count)]
        row = builder.add(weights, builder.mul(loop.index, I64(4 * outputs)))
        for n, of_output in zip(few, slots, strict=True):
            weight = v.splat(v.load(v.after(row, 4 * n), I32))
            for pixel, slot in zip(pixels, of_output, strict=True):
                builder.store(dot(builder.load(slot), pixel, weight), slot)
    return [[builder.load(slot) for slot in of_output] for of_output in slots]


def _splats(v: Vectors, few: range, numbers: Any) -> list[list[Any]]:
    return [[v.splat(v.load(v.after(numbers, 4 * n), F32))] * v.count for n in few]


def _answers(
    v: Vectors, few: range, totals: list[list[Any]], factors: Any, offsets: list[list[Any]]
) -> list[list[Any]]:
    factor = _splats(v, few, factors)
    return [
        [v.multiply_add(v.builder.sitofp(a, v.floats), b, c) for a, b, c in zip(*rows, strict=True)]
        for rows in zip(totals, factor, offsets, strict=True)
    ]


def _store(v: Vectors, answers: list[list[Any]], target: Any, apart: Any, to_bytes: bool) -> Any:
    """Returns where the next outputs go."""
    if to_bytes:
        fours = [answers[n : n + 4] for n in range(0, len(answers), 4)]
        answers = [[v.bytes_of(four) for four in zip(*rows, strict=True)] for rows in fours]
    for row in answers:
        for k, vector in enumerate(row):
            v.store(vector, v.after(target, v.size * k))
        target = v.builder.add(target, apart)
    return target


@intrinsic
def pool(context, isa, upper, lower, target):  # type: ignore[no-untyped-def]
    """The largest of each four pixels of two rows."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        v = Vectors(builder, isa)
        _, upper, lower, target = arguments

        def larger(a: Any, b: Any) -> Any:
            return v.greater(builder.bitcast(a, v.chars), builder.bitcast(b, v.chars))

        def of_rows(k: int) -> Any:
            a, b = (v.load(v.after(row, v.size * k), v.ints) for row in (upper, lower))
            return builder.bitcast(larger(a, b), v.ints)

        for k in range(v.count):
            left, right = of_rows(2 * k), of_rows(2 * k + 1)
            even, odd = (v.pick(left, right, range(first, 2 * v.lanes, 2)) for first in range(2))
            v.store(larger(even, odd), v.after(target, v.size * k))
        return context.get_dummy_value()

    return types.void(isa, *[types.int64] * 3), emit


@intrinsic
def add_coarse(context, isa, fine, share, coarse, apart, target):  # type: ignore[no-untyped-def]
    """A group's pixels, times a share, plus those of a map with half as many; as bytes.

    `coarse` has a plane of floats for each channel, `apart` bytes from one to the next.
    """

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        v = Vectors(builder, isa)
        _, fine, share, coarse, apart, target = arguments
        share = v.splat(share)
        for k in range(v.count):
            pixels, there = v.load(v.after(fine, v.size * k), v.ints), v.after(coarse, v.size // 2 * k)
            sums = []
            for channel in range(4):
                few = v.load(there, v.half_of_floats)
                added = v.pick(few, few, [lane // 2 for lane in range(v.lanes)])
                sums.append(v.multiply_add(builder.sitofp(v.byte(pixels, channel), v.floats), share, added))
                there = builder.add(there, apart)
            v.store(v.bytes_of(sums), v.after(target, v.size * k))
        return context.get_dummy_value()

    return types.void(isa, types.int64, types.float32, *[types.int64] * 3), emit


@intrinsic
def fill(context, address, value):  # type: ignore[no-untyped-def]
    """Set all four bytes of a pixel of a group."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        address, value = arguments
        four = builder.mul(builder.trunc(value, I32), I32(0x01010101))
        builder.store(four, builder.inttoptr(address, I32.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), emit
