"""The edge network in 8-bit numbers, in SIMD code of our own: as fast as the processor multiplies them.

`network` is the runtime, which lays out the maps in memory. `quantise` turns the weights into whole numbers; `forward`
goes through the layers, which threads share, and makes them of `microkernels`; `image` makes the first layer's input.
"""
