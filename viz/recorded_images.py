"""The images of a recording, in any of the forms that it can have them in."""

from __future__ import annotations

import io
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

_COLOUR_MODELS: dict[int, tuple[int, int | None]] = {  # Rerun's number: channels, conversion to BGR
    1: (1, cv2.COLOR_GRAY2BGR),
    2: (3, cv2.COLOR_RGB2BGR),
    3: (4, cv2.COLOR_RGBA2BGR),
    4: (3, None),
    5: (4, cv2.COLOR_BGRA2BGR),
}


class RecordedImages:
    """The image at the cursor, from whatever the recording holds: JPEG, raw pixels or a video."""

    def __init__(self) -> None:
        self._rows: Any = None
        self._k = 0
        self._video: _Video | None = None

    def take(self, rows: Any, k: int) -> None:
        """Row k is the latest."""
        if "AssetVideo:blob" in rows.schema.names:
            self._video = _Video(_bytes(rows, k, "AssetVideo:blob"))
        else:
            self._rows, self._k = rows, k

    def picture(self) -> Picture | None:
        """(H, W, 3) uint8 BGR, None without any."""
        if self._rows is None:
            return None
        names = self._rows.schema.names
        if "EncodedImage:blob" in names:
            data = np.frombuffer(_bytes(self._rows, self._k, "EncodedImage:blob"), np.uint8)
            decoded = cv2.imdecode(data, cv2.IMREAD_COLOR)
            return None if decoded is None else np.asarray(decoded, np.uint8)
        if "Image:buffer" in names:
            return _raw(_bytes(self._rows, self._k, "Image:buffer"), self._rows.column("Image:format")[self._k].as_py())
        if "VideoFrameReference:timestamp" in names and self._video is not None:
            return self._video.at(self._rows.column("VideoFrameReference:timestamp")[self._k].as_py()[0])
        return None


class _Video:
    """Frames of a video in memory, asked for in ascending order."""

    def __init__(self, data: bytes) -> None:
        import av

        self._frames = av.open(io.BytesIO(data), "r").decode(video=0)
        self._shown = self._next = next(self._frames, None)

    def at(self, time_ns: int) -> Picture | None:
        while self._next is not None and round((self._next.time or 0) * 1e9) <= time_ns + 500:
            self._shown, self._next = self._next, next(self._frames, None)
        return None if self._shown is None else np.asarray(self._shown.to_ndarray(format="bgr24"), np.uint8)


def _raw(data: bytes, stated: list[dict[str, Any]]) -> Picture:
    """8-bit pixels that Rerun holds uncompressed."""
    height, width = stated[0]["height"], stated[0]["width"]
    channels, conversion = _COLOUR_MODELS[stated[0]["color_model"]]
    pixels = np.frombuffer(data, np.uint8).reshape(height, width, channels)
    return pixels.copy() if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)


def _bytes(rows: Any, k: int, name: str) -> bytes:
    return rows.column(name)[k].values[0].values.to_numpy().tobytes()  # type: ignore[no-any-return]
