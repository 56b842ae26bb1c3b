"""A row of each kind of layer. Places are addresses, and distances are in bytes."""

from __future__ import annotations

from airline.kernels.compiled import njit
from airline.network.native.microkernels import BLOCK, add_coarse, chars, fill, first, floats, head, pool
from airline.network.native.vectors import TILE

# columns of the table of layers: addresses of weights, factors, offsets and terms; how many terms; how many blocks of
# outputs
WEIGHTS, FACTORS, OFFSETS, TERMS, COUNT, BLOCKS = range(6)
PIXEL = 4  # bytes of a group, or of a float


@njit()
def convolve(isa, layer, turn, source, target, apart, columns):  # type: ignore[no-untyped-def]
    """A convolution, answered as bytes.

    Args:
        isa: see `airline.network.native.vectors`.
        layer: row of the table.
        turn: which of the layer's lists of terms to take.
        source: what the terms are added to for the first pixel.
        target: of the answer's first group.
        apart: from a group to the next.
        columns: how many pixels; what is written beyond them, up to the next whole tile, means nothing.
    """
    count = layer[COUNT]
    terms = layer[TERMS] + 8 * turn * count
    for block in range(layer[BLOCKS]):
        weights = layer[WEIGHTS] + block * BLOCK * PIXEL * count
        factors, offsets = layer[FACTORS] + 4 * BLOCK * block, layer[OFFSETS] + 4 * BLOCK * block
        out = target + BLOCK // 4 * block * apart
        for x in range(0, columns, TILE):
            here, there = source + PIXEL * x, out + PIXEL * x
            chars(isa, here, terms, count, weights, factors, offsets, there, apart)


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
def convolve_to_floats(isa, layer, source, target, apart, columns):  # type: ignore[no-untyped-def]
    """A convolution, answered as a plane of floats for each channel; arguments as for `convolve`."""
    for block in range(layer[BLOCKS]):
        weights = layer[WEIGHTS] + block * BLOCK * PIXEL * layer[COUNT]
        factors, offsets = layer[FACTORS] + 4 * BLOCK * block, layer[OFFSETS] + 4 * BLOCK * block
        out = target + BLOCK * block * apart
        for x in range(0, columns, TILE):
            here, there = source + PIXEL * x, out + PIXEL * x
            floats(isa, here, layer[TERMS], layer[COUNT], weights, factors, offsets, there, apart)


@njit(inline="always")
def convolve_to_logits(isa, layer, source, target, apart, columns):  # type: ignore[no-untyped-def]
    """The last layer, answered as four planes of floats; arguments as for `convolve`."""
    for x in range(0, columns, TILE):
        here, there = source + PIXEL * x, target + PIXEL * x
        head(isa, here, layer[TERMS], layer[COUNT], layer[WEIGHTS], layer[FACTORS], layer[OFFSETS], there, apart)


@njit(inline="always")
def take_largest(isa, groups, upper, stride, apart, target, target_apart, columns):  # type: ignore[no-untyped-def]
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


@njit(inline="always")
def fill_pixel(target, apart, groups, value):  # type: ignore[no-untyped-def]
    """Set all channels of a pixel."""
    for group in range(groups):
        fill(target + group * apart, value)
