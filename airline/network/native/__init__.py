"""The edge network in 8-bit numbers, in SIMD code of our own: as fast as the processor multiplies them.

`network` is the runtime. `quantise` turns the weights into whole numbers and `memory` lays out the maps; `forward` goes
through the layers, with threads that share each by `scheduler`, and makes them of `microkernels`, which are written in
the instructions of `vectors`; `image` makes the first layer's input.
"""
