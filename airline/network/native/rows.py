"""A row of each kind of layer. Sources and targets are addresses; `stride` and what lies `apart` are in bytes."""

from __future__ import annotations

from airline.kernels.compiled import njit
from airline.network.native.microkernels import BLOCK, PIXEL, add_coarse, first, pool, tile
from airline.network.native.vectors import TILE

# columns of the table of layers: addresses of weights, factors, offsets and terms; how many terms; how many blocks of
# outputs
WEIGHTS, FACTORS, OFFSETS, TERMS, COUNT, BLOCKS = range(6)


@njit()
def convolve(isa, kind, layer, turn, source, target, apart, columns):  # type: ignore[no-untyped-def]
    """A convolution.

    Args:
        isa: see `airline.network.processor`.
        kind: of answer, see `airline.network.native.microkernels`.
        layer: (6,) int64 row of the table.
        turn: which of the layer's lists of terms to take.
        source: what the terms are added to for the first pixel.
        target: of the answer's first group, or plane of floats.
        apart: from a group or plane to the next.
        columns: how many pixels; what is written beyond them, up to the next whole tile, means nothing.
    """
    count, outputs = layer[COUNT], len(kind[0])
    planes = outputs // 4 if len(kind[1]) else outputs
    terms = layer[TERMS] + 8 * turn * count
    for block in range(layer[BLOCKS]):
        weights = layer[WEIGHTS] + block * outputs * PIXEL * count
        factors, offsets = layer[FACTORS] + 4 * outputs * block, layer[OFFSETS] + 4 * outputs * block
        out = target + planes * block * apart
        for x in range(0, columns, TILE):
            here, there = source + PIXEL * x, out + PIXEL * x
            tile(isa, kind, here, terms, count, weights, factors, offsets, there, apart)


@njit(inline="always")
def convolve_first(isa, pixels, copies, source, copies_source, target, apart, columns):  # type: ignore[no-untyped-def]
    """The first layer; rows of the table for pixels and for smoothed copies, other arguments as for `convolve`."""
    for block in range(pixels[BLOCKS]):
        weights = pixels[WEIGHTS] + block * BLOCK * PIXEL * pixels[COUNT]
        copies_weights = copies[WEIGHTS] + block * BLOCK * PIXEL * copies[COUNT]
        for x in range(0, columns, TILE):
            first(
                isa,
                source + PIXEL * x,
                pixels[TERMS],
                pixels[COUNT],
                weights,
                pixels[FACTORS] + 4 * BLOCK * block,
                copies_source + PIXEL * x,
                copies[TERMS],
                copies[COUNT],
                copies_weights,
                copies[FACTORS] + 4 * BLOCK * block,
                pixels[OFFSETS] + 4 * BLOCK * block,
                target + BLOCK // 4 * block * apart + PIXEL * x,
                apart,
            )


@njit(inline="always")
def pool_rows(isa, groups, upper, stride, apart, target, target_apart, columns):  # type: ignore[no-untyped-def]
    """A row of the coarser level: of each four pixels of two rows, `stride` from each other, the largest."""
    for group in range(groups):
        for x in range(0, columns, TILE):
            here = upper + group * apart + 2 * PIXEL * x
            pool(isa, here, here + stride, target + group * target_apart + PIXEL * x)


@njit(inline="always")
def add_rows(isa, groups, fine, fine_apart, share, coarse, coarse_apart, target, apart, columns):  # type: ignore[no-untyped-def]
    """A row of a level's map, times `share`, plus the coarser level's floats, each of which counts for two pixels."""
    for group in range(groups):
        for x in range(0, columns, TILE):
            here = fine + group * fine_apart + PIXEL * x
            there = coarse + 4 * group * coarse_apart + PIXEL * x // 2
            add_coarse(isa, here, share, there, coarse_apart, target + group * apart + PIXEL * x)
