"""The edge network in 8-bit numbers, in vector code of our own: as fast as the processor multiplies them.

`network` is the runtime. `quantise` turns the weights into whole numbers and `memory` lays out the maps; `phases` goes
through the layers, with a `crew` of threads; `rows` makes a row of each kind of layer out of `tiles`, which are written
in the instructions of `vectors`; `image` makes the first layer's input.
"""
