"""The numbers of H.264's pictures, which tell that one is missing (ITU-T H.264, 7.3.2.1.1 and 7.3.3)."""

from __future__ import annotations

from logs.messages.types import VideoPacket, units

_HIGH = (100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135)  # profiles with more in their parameter sets
_HEAD = 64  # bytes, more than the part of a unit that is read here


class FrameNumbers:
    """Tells that a picture which others may be predicted from is missing in front of a packet, or out of order."""

    def __init__(self) -> None:
        self._size = 0  # bits of a number; 0 where it is not known
        self._last: int | None = None  # number of the last such picture

    def misses(self, packet: VideoPacket) -> bool:
        """Whether one is missing in front of this packet; nothing is known of streams that may leave numbers out."""
        if packet.format != "h264":
            return False
        for kind, place in units(packet):
            head = bytes(packet.data[place : place + _HEAD])
            try:
                if kind == 7:
                    self._size = _size_of_numbers(_Bits(head))
                elif kind in (1, 5) and self._size:
                    bits = _Bits(head)
                    bits.take(8)
                    for _ in range(3):
                        bits.golomb()
                    number, last = bits.take(self._size), self._last
                    if head[0] & 0x60:
                        self._last = number
                    return kind == 1 and last is not None and (number - last) % (1 << self._size) > 1
            except ValueError:
                return False
        return False


class _Bits:
    def __init__(self, data: bytes) -> None:
        data = data.replace(b"\0\0\3", b"\0\0")
        self._bits = f"{int.from_bytes(data, 'big'):0{8 * len(data)}b}"
        self._place = 0

    def take(self, count: int) -> int:
        """Raises ValueError: there are no more."""
        self._place += count
        return int(self._bits[self._place - count : self._place], 2) if count else 0

    def golomb(self) -> int:
        """An exp-Golomb number; raises ValueError: there are no more."""
        zeros = self._bits.index("1", self._place) - self._place
        self._place += zeros
        return self.take(zeros + 1) - 1


def _size_of_numbers(bits: _Bits) -> int:
    """What a sequence parameter set says, 0 where it is not read that far, or allows gaps."""
    bits.take(8)
    profile = bits.take(8)
    bits.take(16)
    bits.golomb()
    if profile in _HIGH:
        if bits.golomb() == 3:
            bits.take(1)
        bits.golomb()
        bits.golomb()
        bits.take(1)
        if bits.take(1):  # scaling lists
            return 0
    size = bits.golomb() + 4
    order = bits.golomb()
    if order == 0:
        bits.golomb()
    elif order == 1:
        return 0
    bits.golomb()
    return 0 if bits.take(1) else size
