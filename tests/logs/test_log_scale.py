"""16-bit streams to 8 bits: the first image like the detector's own stretch, then steady; and the decoder around it."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
import pytest

from airline.image import to_uint8
from frontend.sources.reading import UndecodableError
from logs.images.decoder import ImageDecoder, SteadyScale
from logs.messages.types import EncodedImage, RawImage
from tests.helpers.camera_messages import picture, rendered

NOISE = np.random.default_rng(3).integers(0, 65536, (64, 96)).astype(np.uint16)


def thermal(shift: float = 0, gain: float = 1) -> np.ndarray:
    grey = cv2.cvtColor(rendered(), cv2.COLOR_BGR2GRAY).astype(np.float64)
    return np.clip(20_000 + shift + gain * 30 * grey, 0, 65535).astype(np.uint16)


def test_first_sixteen_bit_image_is_stretched() -> None:
    for image in (thermal(), NOISE, cv2.merge([thermal(), thermal(90), thermal(-90)])):
        assert np.abs(SteadyScale()(image).astype(int) - to_uint8(image)).max() <= 1


def test_scale_is_steady_and_follows_smoothly() -> None:
    scale = SteadyScale()
    first = scale(thermal())
    rng = np.random.default_rng(0)
    for _ in range(30):  # the scene flickers a little: the same pixel value stays the same grey
        scale(thermal(rng.normal(0, 50), 1 + rng.normal(0, 0.02)))
    np.testing.assert_array_equal(scale(thermal()), first)
    greys = [scale(thermal(9000)).mean() for _ in range(40)]  # it gets much warmer
    assert all(after <= before for before, after in pairwise(greys[:10]))
    assert max(-np.diff(greys)) < 50
    assert abs(greys[-1] - first.mean()) < 5
    np.testing.assert_array_equal(scale(thermal(9000)), scale(thermal(9000)))


@pytest.mark.parametrize("value", [0, 7, 65535])
def test_images_of_one_value_tell_no_range(value: int) -> None:
    constant = np.full((30, 40), value, np.uint16)
    scale = SteadyScale()
    for _ in range(3):
        assert len(np.unique(scale(constant))) == 1
    fresh = SteadyScale()(thermal())
    np.testing.assert_array_equal(scale(thermal()), fresh)
    scale(constant)
    np.testing.assert_array_equal(scale(thermal()), fresh)


def test_decoder_gives_eight_bits() -> None:
    decoder = ImageDecoder()
    (image,) = decoder.decode(RawImage(5, "", 640, 480, "mono16", 0, False, thermal().data.cast("B")))
    np.testing.assert_array_equal(image, SteadyScale()(thermal()))
    (image,) = decoder.decode(EncodedImage(6, "", cv2.imencode(".png", picture())[1].tobytes()))
    np.testing.assert_array_equal(image, picture())
    with pytest.raises(UndecodableError):
        decoder.decode(EncodedImage(7, "", b"?"))
    assert decoder.flush() == []
