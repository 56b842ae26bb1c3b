"""H.264 and H.265: stamps, delay, starts in the middle, damage, hostile sizes."""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction
from functools import cache
from itertools import chain

import av
import numpy as np
import pytest

from frontend.sources.reading import UndecodableError
from logs.images.video import Shown, VideoDecoder
from logs.messages.types import VideoPacket, is_key_frame
from tests.helpers.camera_messages import STAMP_NS, picture

COUNT = 12
GROUP = 6
STEP_NS = 33_333_333
ENCODERS = {"h264": "libx264", "h265": "libx265"}
FORMATS = [
    pytest.param(name, marks=pytest.mark.skipif(codec not in av.codecs_available, reason=f"PyAV is without {codec}"))
    for name, codec in ENCODERS.items()
]
both = pytest.mark.parametrize("name", FORMATS)


def drawn(number: int) -> np.ndarray:
    return np.ascontiguousarray(np.roll(picture(256, 192), 3 * number, axis=1))


@cache
def stream(name: str, b_frames: int = 0) -> list[VideoPacket]:
    """A stream in Annex B with a key frame every six frames, in the order of decoding."""
    encoder = av.CodecContext.create(ENCODERS[name], "w")
    encoder.width, encoder.height, encoder.pix_fmt = 256, 192, "yuv444p"
    encoder.time_base = Fraction(1, 10**9)
    parameters = f"keyint={GROUP}:min-keyint={GROUP}:scenecut=0:bframes={b_frames}:crf=8"
    more = ":log-level=none:repeat-headers=1:open-gop=0" if name == "h265" else ""
    encoder.options = {"preset": "veryfast", "threads": "1", f"{ENCODERS[name][3:]}-params": parameters + more}
    packets = []
    for number in [*range(COUNT), None]:
        frame = None
        if number is not None:
            frame = av.VideoFrame.from_ndarray(drawn(number), format="bgr24")
            frame.pts = number
        packets += encoder.encode(frame)
    return [VideoPacket(stamp_of(packet.pts), "camera", name, bytes(packet)) for packet in packets]


def stamp_of(number: int) -> int:
    return STAMP_NS + number * STEP_NS


def run(packets: list[VideoPacket]) -> tuple[list[list[tuple[int, np.ndarray]]], dict[int, str]]:
    """Images per packet and, as the last, those flushed; reasons of the packets that failed."""
    decoder = VideoDecoder()
    images, failures = [], {}
    for place, packet in enumerate(packets):
        try:
            images.append(stamped(decoder.feed(packet, place)))
        except UndecodableError as error:
            failures[place] = error.reason
            images.append([])
    return [*images, stamped(decoder.flush())], failures


def stamped(found: list[Shown]) -> list[tuple[int, np.ndarray]]:
    return [(shown.stamp_ns, shown.image) for shown in found]


def check(images: list[tuple[int, np.ndarray]], numbers: list[int]) -> None:
    """The images are those of these numbers, with their stamps and pixels."""
    assert [stamp for stamp, _ in images] == [stamp_of(number) for number in numbers]
    for number, (_, image) in zip(numbers, images, strict=True):
        assert image.shape == (192, 256, 3)
        assert image.dtype == np.uint8
        assert image.flags.c_contiguous
        assert image.flags.writeable
        difference = image.astype(int) - drawn(number)
        assert np.abs(difference).mean() < 4
        assert np.abs(difference.mean(axis=(0, 1))).max() < 1.5


@both
def test_every_packet_gives_its_image_at_once(name: str) -> None:
    images, failures = run(stream(name))
    assert not failures
    assert [len(found) for found in images] == [1] * COUNT + [0]
    check([found[0] for found in images[:-1]], list(range(COUNT)))


@both
def test_stamps_stay_with_their_images_under_reordering(name: str) -> None:
    packets = stream(name, b_frames=2)
    order = [packet.stamp_ns for packet in packets]
    assert order != sorted(order)
    images, failures = run(packets)
    assert not failures
    check(list(chain(*images)), list(range(COUNT)))


@both
def test_key_frames(name: str) -> None:
    packets = stream(name)
    assert [is_key_frame(packet) for packet in packets] == [place % GROUP == 0 for place in range(COUNT)]
    for data in (b"", b"\0\0\1", b"\0\0\0", bytes(50)):
        assert not is_key_frame(VideoPacket(0, "", name, data))


@both
def test_start_in_the_middle_waits_for_a_key_frame(name: str) -> None:
    images, failures = run(stream(name)[2:])
    assert failures == {place: "waits for a key frame" for place in range(GROUP - 2)}
    check(list(chain(*images)), list(range(GROUP, COUNT)))


@both
@pytest.mark.parametrize("share", [0.05, 0.3])
def test_damage_costs_up_to_the_next_key_frame(name: str, share: float) -> None:
    packets = list(stream(name))
    whole = packets[2]
    packets[2] = VideoPacket(whole.stamp_ns, "", name, whole.data[: int(share * len(whole.data))])
    images, failures = run(packets)
    assert failures == {2: "damaged video frame", **{place: "waits for a key frame" for place in range(3, GROUP)}}
    check(list(chain(*images)), [0, 1, *range(GROUP, COUNT)])


@pytest.mark.parametrize("name", FORMATS[1:])
def test_missing_h265_picture_is_noticed(name: str) -> None:
    packets = stream(name)
    images, failures = run(packets[:2] + packets[3:])
    assert failures == {2: "damaged video frame", **{place: "waits for a key frame" for place in range(3, GROUP - 1)}}
    check(list(chain(*images)), [0, 1, *range(GROUP, COUNT)])


@both
def test_empty_packet_does_not_end_the_stream(name: str) -> None:
    decoder = VideoDecoder()
    packets = stream(name)
    check(stamped(decoder.feed(packets[0])), [0])
    with pytest.raises(UndecodableError):
        decoder.feed(VideoPacket(0, "", name, b""))
    check(stamped(decoder.feed(packets[1])), [1])


def exp_golomb(number: int) -> str:
    bits = f"{number + 1:b}"
    return "0" * (len(bits) - 1) + bits


def test_huge_h264_picture() -> None:
    """A sequence parameter set that claims 65520x65520 pixels, before the pictures of a small stream."""
    fields = [0, 0, 2, 1]  # its number, bits of frame numbers, order of output, reference frames
    bits = "".join(map(exp_golomb, fields)) + "0" + exp_golomb(4094) * 2 + "11001"
    body = int(bits.ljust(-(-len(bits) // 8) * 8, "0"), 2).to_bytes(-(-len(bits) // 8), "big")
    huge = b"\0\0\0\1\x67\x42\0\x33" + body + b"\0\0\0\1\x68\xce\x38\x80" + b"\0\0\0\1\x65\x88\x84\0" + bytes(200)
    decoder = VideoDecoder()
    with pytest.raises(UndecodableError):
        decoder.feed(VideoPacket(0, "", "h264", huge))


@both
def test_change_of_format(name: str) -> None:
    other = "h265" if name == "h264" else "h264"
    decoder = VideoDecoder()
    check(stamped(decoder.feed(stream(name)[0])), [0])
    check(stamped(decoder.feed(stream(other)[0])), [0])
    check(stamped(decoder.feed(stream(name)[GROUP])), [GROUP])


@both
@pytest.mark.parametrize("b_frames", [0, 2])
def test_mutated_streams(name: str, b_frames: int, capfd: pytest.CaptureFixture[str]) -> None:
    """Nothing but UndecodableError, no chatter, no stamp that was not fed; afterwards a whole stream is read whole."""
    rng = np.random.default_rng(5)
    decoder = VideoDecoder()
    for _ in range(25):
        found: list[tuple[int, np.ndarray]] = []
        for packet in stream(name, b_frames):
            data = bytearray(packet.data)
            for _ in range(rng.integers(0, 3)):
                start = int(rng.integers(len(data) if rng.random() < 0.5 else min(40, len(data))))
                noise = rng.bytes(int(rng.choice([1, 2, 16])))
                data[start : start + len(noise)] = noise
            if rng.random() < 0.1:
                del data[rng.integers(len(data)) :]
            with suppress(UndecodableError):
                found += stamped(decoder.feed(VideoPacket(packet.stamp_ns, "", name, bytes(data))))
        found += stamped(decoder.flush())
        assert {stamp for stamp, _ in found} <= {packet.stamp_ns for packet in stream(name, b_frames)}
    images = [image for packet in stream(name, b_frames) for image in stamped(decoder.feed(packet))]
    check(images + stamped(decoder.flush()), list(range(COUNT)))
    assert capfd.readouterr().err == ""
