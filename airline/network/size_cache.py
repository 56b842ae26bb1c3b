"""What a network has ready for the kinds of image of late."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")
KEPT = 4


class Sizes(Generic[T]):
    """Keeps what was made for the last few sizes.

    Args:
        make: called with the size that there is nothing for.
    """

    def __init__(self, make: Callable[..., T]) -> None:
        self._make = make
        self._kept: OrderedDict[tuple[Hashable, ...], T] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    def of(self, *size: Hashable) -> T:
        """What there is for a size."""
        if size not in self._kept:
            self._kept[size] = self._make(*size)
            if len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(size)
        return self._kept[size]
