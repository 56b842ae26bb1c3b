"""What is done to one or two vectors of neighbouring pixels; numba compiles these into their callers.

All arguments but `isa` are addresses and counts; see `airline.runtimes.native.vectors`.
"""

from __future__ import annotations

from typing import Any

from numba.core import cgutils, types

from airline.runtimes.native.vectors import F32, I32, I64, Vectors
from airline.spin import intrinsic

AT_ONCE = 8  # totals, where there are 16 registers, not 32 as with AVX-512


def _convolution(dot: str, outputs: int, vectors: int, to_bytes: bool) -> Any:
    @intrinsic
    def tile(context, isa, source, terms, count, weights, factors, offsets, target, apart):  # type: ignore[no-untyped-def]
        """Answer some channels.

        Args:
            source: of the pixels, to which is added
            terms: where each group that counts lies, int64 bytes,
            count: of them.
            weights: (count, outputs, 4 bytes).
            factors, offsets: (outputs,) float32, from totals to answers.
            target: where the answers go, as bytes or as floats.
            apart: from a group, or from a channel of floats, to the next, bytes.
        """

        def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            v = Vectors(builder, isa)
            _, source, terms, count, weights, factors, offsets, target, apart = arguments
            few = outputs if v.lanes == 16 else min(outputs, AT_ONCE // vectors)
            for first in range(0, outputs, few):
                place = v.after(weights, 4 * first)
                totals = _totals(v, dot, few, vectors, source, terms, count, place, 4 * outputs)
                answers = [
                    _answers(v, row, v.after(factors, 4 * (first + n)), v.after(offsets, 4 * (first + n)))
                    for n, row in enumerate(totals)
                ]
                for n in range(0, few, 4 if to_bytes else 1):
                    for k in range(vectors):
                        value = v.bytes_of([answers[n + c][k] for c in range(4)]) if to_bytes else answers[n][k]
                        v.store(value, v.after(target, 4 * v.lanes * k))
                    target = builder.add(target, apart)
            return context.get_dummy_value()

        return types.void(isa, *[types.int64] * 8), emit

    return tile


def _totals(
    v: Vectors, dot: str, outputs: int, vectors: int, source: Any, terms: Any, count: Any, weights: Any, apart: int
) -> list[list[Any]]:
    """By output and vector; `apart`: from the weights of a term to those of the next, bytes."""
    builder = v.builder
    slots = [[v.slot() for _ in range(vectors)] for _ in range(outputs)]
    with cgutils.for_range(builder, count) as loop:
        place = builder.add(source, v.load(builder.add(terms, builder.mul(loop.index, I64(8))), I64))
        pixels = [v.load(v.after(place, 4 * v.lanes * k), v.ints) for k in range(vectors)]
        row = builder.add(weights, builder.mul(loop.index, I64(apart)))
        for n in range(outputs):
            weight = v.splat(v.load(v.after(row, 4 * n), I32))
            for slot, pixel in zip(slots[n], pixels, strict=True):
                builder.store(getattr(v, dot)(builder.load(slot), pixel, weight), slot)
    return [[builder.load(slot) for slot in row] for row in slots]


def _answers(v: Vectors, totals: list[Any], factor: Any, offset: Any) -> list[Any]:
    factor, offset = (v.splat(v.load(each, F32)) for each in (factor, offset))
    return [v.multiply_add(v.builder.sitofp(total, v.floats), factor, offset) for total in totals]


words_two, words_one = _convolution("dot_words", 8, 2, True), _convolution("dot_words", 8, 1, True)
bytes_two, bytes_one = _convolution("dot_bytes", 8, 2, True), _convolution("dot_bytes", 8, 1, True)
floats_one = _convolution("dot_bytes", 8, 1, False)
head_one = _convolution("dot_bytes", 4, 1, False)


@intrinsic
def pool(context, isa, upper, lower, target):  # type: ignore[no-untyped-def]
    """The largest of each four pixels of two rows."""

    def emit(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        v = Vectors(builder, isa)
        _, upper, lower, target = arguments
        halves = []
        for k in range(2):
            rows = [v.load(v.after(row, 4 * v.lanes * k), v.chars) for row in (upper, lower)]
            halves.append(builder.bitcast(v.greater(*rows), v.ints))
        left, right = halves
        columns = [
            builder.bitcast(v.pick(left, right, list(range(first, 2 * v.lanes, 2))), v.chars) for first in range(2)
        ]
        v.store(v.greater(*columns), target)
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
        pixels, share = v.load(fine, v.ints), v.splat(share)
        byte, twice = v.ints([255] * v.lanes), [k // 2 for k in range(v.lanes)]
        sums = []
        for c in range(4):
            few = v.load(coarse, v.half_of_floats)
            channel = builder.and_(builder.lshr(pixels, v.ints([8 * c] * v.lanes)), byte)
            sums.append(v.multiply_add(builder.sitofp(channel, v.floats), share, v.pick(few, few, twice)))
            coarse = builder.add(coarse, apart)
        v.store(v.bytes_of(sums), target)
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
