"""Logs as people have them: times, order, number and content of the frames, and the sentence where there are none."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.writer import Writer
from rosbags import rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_typestore

from airline.errors import InputError
from logs import LogImageSource, McapImageSource, open_images
from tests.frontend.test_image_files import as_stored, saved
from tests.helpers import log_pictures as pictures
from tests.helpers.camera_logs import Channel, Logged, text, write_log
from tests.helpers.camera_messages import cdr, image_fields
from tests.helpers.command import command
from tests.helpers.log_pictures import compressed, difference, logged, number_in, numbered, raw, stamp, video_log
from tests.logs.test_log_images import BAYER, mosaic

COUNT = 40


def shown(source: LogImageSource, first: int = 0, count: int = COUNT) -> None:
    """All frames from a number on come, each whole and with its time and number."""
    frames = list(source)
    assert [frame.stamp_ns for frame in frames] == [stamp(k) for k in range(first, count)]
    assert [number_in(frame.image) for frame in frames] == list(range(first, count))
    assert max(difference(frame.image, number_in(frame.image)) for frame in frames) < 9


# Bayer and 16 bits


def files(image: np.ndarray, suffix: str) -> bytes:
    return cv2.imencode(suffix, image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()


@pytest.mark.parametrize("pattern", BAYER)
@pytest.mark.parametrize(
    ("text", "suffix", "bits"),
    [
        ("bayer_{}8; jpeg compressed ", ".jpg", 8),
        ("bayer_{}8; png compressed ", ".png", 8),
        ("bayer_{}8;png", ".png", 8),
        ("bayer_{}8; jpeg compressed bayer_{}8", ".jpg", 8),
        ("bayer_{}16; png compressed ", ".png", 16),
        ("bayer_{}10p; jpeg compressed ", ".jpg", 8),
        ("bayer_{}12", ".png", 8),
        ("bayer_{}; png", ".png", 8),
        ("Bayer{2}8", ".png", 8),
        ("BayerX; Bayer{2}12p", ".png", 8),
    ],
)
def test_compressed_mosaics_are_debayered(tmp_path: Path, pattern: str, text: str, suffix: str, bits: int) -> None:
    text = text.replace("{}", pattern).replace("{2}", pattern[:2].upper())
    seen = [mosaic(numbered(k), pattern).astype(np.uint16) << (bits - 8) for k in range(3)]
    data = [files(image.astype(np.uint8 if bits == 8 else np.uint16), suffix) for image in seen]
    messages = [compressed(one, stamp(k), text) for k, one in enumerate(data)]
    source = McapImageSource(write_log(tmp_path / "a.mcap", {"/camera": logged(messages)}))
    assert source.codec == f"{'JPEG' if suffix == '.jpg' else 'PNG'} (bayer_{pattern}{bits})"
    frames = list(source)
    assert [frame.stamp_ns for frame in frames] == [stamp(k) for k in range(3)]
    assert [number_in(frame.image) for frame in frames] == [0, 1, 2]
    blue, green, red = frames[0].image[100:124, 4:60].reshape(-1, 3).mean(axis=0)
    assert red > green + 30 > blue + 60
    assert source.notes == [f"compressed images were taken for bayer_{pattern}{bits} mosaics, as their format says"]


@pytest.mark.parametrize(
    ("text", "image"),
    [
        ("bayer_rggb8; jpeg compressed bgr8", numbered(5)),
        ("bayer_rggb8; jpeg compressed mono8", cv2.cvtColor(numbered(5), cv2.COLOR_BGR2GRAY)),
        ("rgb8; jpeg compressed bgr8", numbered(5)),
        ("mono8; jpeg compressed ", cv2.cvtColor(numbered(5), cv2.COLOR_BGR2GRAY)),
    ],
)
def test_what_was_debayered_before_stays_as_it_is(tmp_path: Path, text: str, image: np.ndarray) -> None:
    path = write_log(tmp_path / "a.mcap", {"/camera": logged([compressed(files(image, ".png"), stamp(0), text)])})
    source = McapImageSource(path)
    (frame,) = source
    np.testing.assert_array_equal(frame.image, image)
    assert not source.notes


def test_thermal_images_are_shown(tmp_path: Path) -> None:
    kelvin = cv2.cvtColor(numbered(7), cv2.COLOR_BGR2GRAY).astype(np.uint16) * 8 + 27_000
    for k, message in enumerate(
        [
            (compressed(files(kelvin, ".png"), stamp(0), "mono16; png compressed "), "CompressedImage"),
            (compressed(files(kelvin, ".png"), stamp(0), "16UC1; png compressed "), "CompressedImage"),
            (raw(kelvin, stamp(0), "16UC1"), "Image"),
            (raw(kelvin, stamp(0), "mono16"), "Image"),
        ]
    ):
        path = write_log(tmp_path / f"{k}.mcap", {"/thermal/image": logged(message[:1], kind=message[1])})
        (frame,) = McapImageSource(path)
        assert number_in(frame.image) == 7
        assert frame.image.dtype == np.uint8


def test_two_channels_are_grey(tmp_path: Path) -> None:
    grey = cv2.cvtColor(numbered(9), cv2.COLOR_BGR2GRAY)
    image = np.dstack([grey, np.full_like(grey, 128)])
    source = McapImageSource(
        write_log(tmp_path / "a.mcap", {"/c": logged([raw(image, stamp(0), "8UC2")], kind="Image")})
    )
    (frame,) = source
    np.testing.assert_array_equal(frame.image, grey)
    assert source.notes == ["of 8UC2 images the first channel was taken, as grey"]


# Video


STREAMS: dict[str, tuple[str, Callable[[], list[tuple[int, bytes]]]]] = {
    "h264": ("h264", lambda: pictures.x264(COUNT, "bframes=0")),
    "h264 B": ("h264", lambda: pictures.x264(COUNT, "bframes=2")),
    "h264 B pyramid": ("h264", lambda: pictures.x264(COUNT, "bframes=3:b-pyramid=normal:ref=4")),
    "h264 open B": ("h264", lambda: pictures.x264(COUNT, "bframes=3:open-gop=1")),
    "h264 silent": ("h264", lambda: silent(pictures.x264(COUNT, "bframes=0"))),
    "h264 silent B": ("h264", lambda: silent(pictures.x264(COUNT, "bframes=3:b-pyramid=normal:ref=4"))),
    "h265 B": ("h265", lambda: pictures.x265(COUNT, "bframes=2:open-gop=0")),
    "h265 open B": ("h265", lambda: pictures.x265(COUNT, "bframes=3:open-gop=1")),
    "vp9": ("vp9", lambda: pictures.encode("libvpx-vp9", COUNT, g="12", crf="8", b="0", **{"cpu-used": "8"})),
    "av1": ("av1", lambda: pictures.encode("libsvtav1", COUNT, g="12", crf="5", preset="8")),
}
REORDERED = {name for name in STREAMS if name.endswith(("B", "pyramid"))}


def golomb(bits: str, place: int) -> int:
    """The place behind an exp-Golomb number."""
    zeros = bits.index("1", place) - place
    return place + 2 * zeros + 1


def silent(packets: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """The same stream without the part of its sequence parameter sets that says how far pictures are out of order."""

    def rewritten(data: bytes) -> bytes:
        found = re.search(b"\0\0\1\x67", data)
        if found is None:
            return data
        end = data.index(b"\0\0\1", found.end())
        end -= data[end - 1] == 0
        body = data[found.end() : end].replace(b"\0\0\3", b"\0\0")
        bits, place = "".join(f"{byte:08b}" for byte in body), 24
        place = golomb(bits, place)
        if body[0] == 100:
            place = golomb(bits, golomb(bits, golomb(bits, place))) + 2
        place = golomb(bits, place)
        if bits[place] == "1":  # order of output of type 0
            place = golomb(bits, place)
        place = golomb(bits, place)
        place = golomb(bits, golomb(bits, golomb(bits, place) + 1)) + 2
        cropped = bits[place] == "1"
        place += 1
        for _ in range(4 * cropped):
            place = golomb(bits, place)
        assert bits[place] == "1"
        shorter = bits[:place] + "01"
        size = -(-len(shorter) // 8)
        whole = int(shorter.ljust(8 * size, "0"), 2).to_bytes(size, "big")
        return data[: found.end()] + re.sub(rb"\0\0(?=[\0-\3])", lambda _: b"\0\0\3", whole) + data[end:]

    return [(shown, rewritten(data)) for shown, data in packets]


@pytest.mark.parametrize("name", STREAMS)
@pytest.mark.parametrize("rising", [True, False])
def test_video_comes_in_display_order(
    tmp_path: Path, name: str, rising: bool, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    kind, make = STREAMS[name]
    packets = make()
    assert ([place for place, _ in packets] != list(range(COUNT))) == (name in REORDERED)
    capfd.readouterr()
    source = McapImageSource(video_log(tmp_path / "a.mcap", packets, kind, rising))
    assert source.codec == kind
    frames = list(source)
    assert [frame.stamp_ns for frame in frames] == [stamp(k) for k in range(COUNT)]
    assert [frame.index for frame in frames] == list(range(COUNT))
    assert [number_in(frame.image) for frame in frames] == list(range(COUNT))
    assert max(difference(frame.image, k) for k, frame in enumerate(frames)) < 9
    assert source.skipped == 0
    assert not caplog.records
    assert capfd.readouterr().err == ""
    assert [("B-frames" in note) for note in source.notes] == [True] * (rising and name in REORDERED)


@pytest.mark.parametrize("name", STREAMS)
def test_video_from_its_middle_has_no_ghosts(tmp_path: Path, name: str) -> None:
    """It begins at the first key frame; what is shown before it there, or is predicted from before it, is left out."""
    kind, make = STREAMS[name]
    frames = list(McapImageSource(video_log(tmp_path / "a.mcap", make()[5:], kind, rising=False)))
    numbers = [number_in(frame.image) for frame in frames]
    assert numbers == list(range(12, COUNT))
    assert [frame.stamp_ns for frame in frames] == [stamp(k) for k in numbers]
    assert max(difference(frame.image, k) for k, frame in zip(numbers, frames, strict=True)) < 9


@pytest.mark.parametrize("headers", [True, False])
def test_intra_refresh_starts_from_the_middle(tmp_path: Path, headers: bool) -> None:
    packets = pictures.x264(COUNT, "bframes=0:intra-refresh=1")
    if not headers:  # only the recovery point is left behind the first picture, whose header comes first
        first = packets[0][1]
        packets = [
            (k, data[data.index(b"\0\0\1\x06") - 1 :] if k and b"\0\0\1\x67" in data else data) for k, data in packets
        ]
        packets[5] = 5, first[: first.index(b"\0\0\1\x65") - 1] + packets[5][1]
    frames = list(McapImageSource(video_log(tmp_path / "a.mcap", packets[5:], "h264", rising=False)))
    numbers = [number_in(frame.image) for frame in frames]
    assert numbers == list(range(numbers[0], COUNT))
    assert numbers[0] <= 24
    assert [frame.stamp_ns for frame in frames] == [stamp(k) for k in numbers]
    assert max(difference(frame.image, k) for k, frame in zip(numbers, frames, strict=True)) < 9


@pytest.mark.parametrize("name", ["h264", "h264 silent", "h264 B", "h264 silent B"])
@pytest.mark.parametrize("damaged", [1, 2, 14, 15, 16])
@pytest.mark.parametrize("rising", [False, True])
def test_damage_among_delayed_pictures_makes_no_ghosts(tmp_path: Path, name: str, damaged: int, rising: bool) -> None:
    kind, make = STREAMS[name]
    packets = make()
    shown_at, data = packets[damaged]
    packets[damaged] = shown_at, data[: len(data) // 3]
    frames = list(McapImageSource(video_log(tmp_path / "a.mcap", packets, kind, rising)))
    numbers = [number_in(frame.image) for frame in frames]
    assert [frame.stamp_ns for frame in frames] == [stamp(k) for k in numbers]
    assert max(difference(frame.image, k) for k, frame in zip(numbers, frames, strict=True)) < 9
    last = 12 * (damaged // 12 + 1)
    assert set(numbers) >= {*range(last - 12), *range(last, COUNT)}  # at most one group is lost
    assert shown_at not in numbers


@pytest.mark.parametrize("name", ["h264", "h264 B", "h264 B pyramid", "h264 open B"])
@pytest.mark.parametrize("fault", ["lost", "late", "swapped", "again"])
@pytest.mark.parametrize("place", [5, 12, 14])
def test_missing_and_late_packets_make_no_ghosts(tmp_path: Path, name: str, fault: str, place: int) -> None:
    kind, make = STREAMS[name]
    packets = make()
    opened = name == "h264 open B"
    if opened and (place, fault) == (12, "swapped"):
        pytest.skip("a B-frame in front of the picture that it needs has no number that tells")
    match fault:
        case "lost":
            del packets[place]
        case "again":
            packets.insert(place + 2, packets[place])
        case _:
            packets.insert(place + (1 if fault == "swapped" else 2), packets.pop(place))
    source = McapImageSource(video_log(tmp_path / "a.mcap", packets, kind, rising=False))
    frames = list(source)
    numbers = [number_in(frame.image) for frame in frames]
    assert [frame.stamp_ns for frame in frames] == [stamp(k) for k in numbers]
    assert max(difference(frame.image, k) for k, frame in zip(numbers, frames, strict=True)) < 9
    assert set(numbers) >= {*range(place // 12 * 12 - 3), *range(36 if opened else 24, COUNT)}
    assert len(frames) + source.skipped - len(packets) in ((-1, 0, 1) if opened else (0,))
    assert fault != "again" or len(frames) == COUNT


def test_a_video_whose_headers_are_whole_seconds(tmp_path: Path) -> None:
    messages = (compressed(data, stamp(k) // 10**9 * 10**9, "h264") for k, (_, data) in enumerate(pictures.x264(COUNT)))
    source = McapImageSource(write_log(tmp_path / "a.mcap", {"/camera": logged(messages)}))
    frames = list(source)
    assert [number_in(frame.image) for frame in frames] == list(range(COUNT))
    assert {b.stamp_ns - a.stamp_ns for a, b in pairwise(frames)} == {pictures.STEP_NS}
    assert any("more than once" in note for note in source.notes)


# Times of messages


@pytest.mark.parametrize(
    ("arrival", "late"),
    [
        ([0, 1, 3, 4, 2, 5, 7, 6, 8, 10, 11, 9], 3),
        ([1, 0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11], 1),
        ([0, 1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 6], 1),
    ],
)
@pytest.mark.parametrize("kind", ["Image", "CompressedImage"])
def test_late_images_have_their_own_stamps(
    tmp_path: Path, arrival: list[int], late: int, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    def message(k: int) -> bytes:
        image = numbered(k)
        return raw(image, stamp(k), "bgr8") if kind == "Image" else compressed(files(image, ".png"), stamp(k), "png")

    times = [max(map(stamp, arrival[: place + 1])) + 1000 + place for place in range(12)]
    path = write_log(tmp_path / "a.mcap", {"/camera": logged(map(message, arrival), times, kind)})
    source = McapImageSource(path)
    assert (source.first_stamp_ns, source.last_stamp_ns) == (stamp(0), stamp(11))
    shown(source, count=12)
    assert source.skipped == 0
    assert not caplog.records
    what = "1 message that was" if late == 1 else f"{late} messages that were"
    assert source.notes == [f"{what} logged late came in order by header time; --time-source log keeps the log's order"]
    source = McapImageSource(path, time_source="log")
    assert [number_in(frame.image) for frame in source] == arrival
    assert not source.notes


def test_one_header_ahead_changes_no_other(tmp_path: Path) -> None:
    ahead_ns = [3600 * 10**9 if k == 7 else 0 for k in range(COUNT)]
    messages = (raw(numbered(k), stamp(k) + ahead_ns[k], "bgr8") for k in range(COUNT))
    source = McapImageSource(write_log(tmp_path / "a.mcap", {"/camera": logged(messages, kind="Image")}))
    shown(source)
    assert source.notes == [
        "1 header time ahead of all others gave way to the log's clock (--time-source log uses it throughout)"
    ]


@pytest.mark.parametrize("unit", [10**9, 10**8])
def test_coarse_headers_keep_all_frames(tmp_path: Path, unit: int, caplog: pytest.LogCaptureFixture) -> None:
    messages = (raw(numbered(k), stamp(k) // unit * unit, "bgr8") for k in range(COUNT))
    source = McapImageSource(write_log(tmp_path / "a.mcap", {"/camera": logged(messages, kind="Image")}))
    frames = list(source)
    assert [number_in(frame.image) for frame in frames] == list(range(COUNT))
    assert {b.stamp_ns - a.stamp_ns for a, b in pairwise(frames[3:])} == {pictures.STEP_NS}
    assert max(abs(frame.stamp_ns - stamp(k)) for k, frame in enumerate(frames)) <= unit
    assert len(source.notes) == 1
    assert not caplog.records


# Messages that are compressed, depth, and what is not readable


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_compressed_messages_in_one_file(tmp_path: Path, storage: StoragePlugin) -> None:
    writer = rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=storage)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        typestore = get_typestore(Stores.ROS2_HUMBLE)
        camera = writer.add_connection("/camera", "sensor_msgs/msg/Image", typestore=typestore)
        for k in range(6):
            writer.write(camera, stamp(k), raw(numbered(k), stamp(k), "bgr8"))
    (path,) = [path for path in (tmp_path / "bag").iterdir() if path.suffix != ".yaml"]
    single = path.rename(tmp_path / f"single{'.mcap' if storage is StoragePlugin.MCAP else '.db3'}")
    shown(open_images(single), count=6)


DEPTH = (np.arange(64 * 96, dtype=np.uint16) % 5000).reshape(64, 96)
DISPARITY = Channel("stereo_msgs/msg/DisparityImage", "cdr", [Logged(stamp(0), b"\0\1\0\0")])
MEASURED = {
    "float": logged([raw(DEPTH.astype(np.float32), stamp(0), "32FC1")], kind="Image"),
    "16 bits": logged([raw(DEPTH, stamp(0), "16UC1")], kind="Image"),
    "PNG": logged([compressed(files(DEPTH, ".png"), stamp(0), "16UC1; png compressed ")]),
    "nameless PNG": logged([compressed(files(DEPTH, ".png"), stamp(0), "png")]),
    "compressedDepth": logged([compressed(bytes(12) + files(DEPTH, ".png"), stamp(0), "16UC1; compressedDepth png")]),
    "RVL": logged([compressed(bytes(40), stamp(0), "16UC1; compressedDepth rvl")]),
    "disparity": DISPARITY,
}


@pytest.mark.parametrize("kind", MEASURED)
def test_depth_is_refused_by_what_it_is(tmp_path: Path, kind: str) -> None:
    name = "/camera/aligned_depth_to_color/image_raw"
    path = write_log(tmp_path / "a.mcap", {name: MEASURED[kind], "/chatter": text()})
    with pytest.raises(InputError, match=r"is depth, which is measured, not seen.*the log has no other images"):
        McapImageSource(path)
    colour = logged([raw(numbered(k), stamp(k), "bgr8") for k in range(3)], kind="Image")
    path = write_log(tmp_path / "b.mcap", {name: MEASURED[kind], "/depth_camera/color/image_raw": colour})
    source = McapImageSource(path)
    shown(source, count=3)
    assert source.notes == [
        "/depth_camera/color/image_raw is the only image topic that is not depth; --topic takes another"
    ]
    with pytest.raises(
        InputError, match=r"measured, not seen.*by --topic: /depth_camera/color/image_raw \(sensor_msgs"
    ):
        McapImageSource(path, name)
    two = {name: MEASURED[kind], "/left": colour, "/right": colour}
    with pytest.raises(InputError, match=r"choose one with --topic: /left .*/right"):
        McapImageSource(write_log(tmp_path / "c.mcap", two))


@pytest.mark.parametrize(
    ("messages", "kind", "reason"),
    [
        ([cdr("Image", stamp_ns=5, **image_fields(bytes(64), 4, 4, "ycbcr9", 16))], "Image", "'ycbcr9'"),
        ([compressed(b"\0\1\2\3" + bytes(30), 5, "jpeg")], "CompressedImage", "no image file that is known"),
        ([compressed(b"\0\0\0\1\x09\x10", 5, "theora")], "CompressedImage", "waits for a key frame"),
    ],
)
def test_an_unreadable_topic_says_what_to_do(tmp_path: Path, messages: list[bytes], kind: str, reason: str) -> None:
    other = logged([raw(numbered(0), stamp(0), "bgr8")], kind="Image")
    path = write_log(tmp_path / "a.mcap", {"/odd": logged(messages, kind=kind), "/left": other})
    with pytest.raises(InputError, match=rf"{re.escape(reason)}.*mcap\.md.*--topic takes another topic: /left"):
        list(McapImageSource(path, "/odd"))


@pytest.mark.parametrize(
    ("topic", "encoding"),
    [
        ("/oak/stereo/image_raw", "16UC1"),
        ("/camera/depthImage", "mono16"),
        ("/tof/range", "16UC1"),
        ("/ouster/range_image", "mono16"),
        ("/camera/rgbd", "16UC1"),
    ],
)
def test_depth_by_its_other_names(tmp_path: Path, topic: str, encoding: str) -> None:
    depth = logged([raw(DEPTH, stamp(0), encoding)], kind="Image")
    with pytest.raises(InputError, match="is depth, which is measured, not seen"):
        McapImageSource(write_log(tmp_path / "a.mcap", {topic: depth}))
    seen = logged([raw(DEPTH, stamp(k), "mono16") for k in range(3)], kind="Image")
    topics = {topic: depth, "/stereo/left/image_raw": seen}
    assert len(list(McapImageSource(write_log(tmp_path / "b.mcap", topics)))) == 3


def test_temperatures_are_called_values(tmp_path: Path) -> None:
    kelvin = logged([raw(DEPTH.astype(np.float32), stamp(0), "32FC1")], kind="Image")
    with pytest.raises(InputError, match="holds values such as temperature or depth, measured, not seen"):
        McapImageSource(write_log(tmp_path / "a.mcap", {"/thermal/temperature": kelvin}))


@pytest.mark.parametrize("text", ["", "16UC1", "16UC1; compresseddepth png"])
def test_compressed_depth_by_its_topic_or_text(tmp_path: Path, text: str) -> None:
    messages = logged([compressed(bytes(12) + files(DEPTH, ".png"), stamp(0), text)])
    topic = "/camera/image/compressed" if "depth" in text else "/camera/image/compressedDepth"
    with pytest.raises(InputError, match="measured, not seen"):
        McapImageSource(write_log(tmp_path / "a.mcap", {topic: messages}))


@pytest.mark.parametrize("text", ["jpeg; avc", "image/jpeg; camera=av1", "h264 like jpeg"])
def test_the_bytes_tell_an_image_file_from_video(tmp_path: Path, text: str) -> None:
    messages = logged([compressed(files(numbered(k), ".jpg"), stamp(k), text) for k in range(3)])
    shown(McapImageSource(write_log(tmp_path / "a.mcap", {"/camera": messages})), count=3)


@pytest.mark.parametrize("name", ["h264 B", "h265 B"])
def test_parameter_sets_in_messages_of_their_own(tmp_path: Path, name: str) -> None:
    kind, make = STREAMS[name]
    picture = b"\0\0\1[\x06\x65]" if kind == "h264" else b"\0\0\1[\x26\x28\x2a\x4e]"
    packets = []
    for k, data in make():
        found = re.search(picture, data)
        if k % 12 == 0 and found is not None and found.start() > 4:
            packets.append((k, data[: found.start()]))
            data = data[found.start() :]
        packets.append((k, data))
    assert len(packets) > COUNT
    source = McapImageSource(video_log(tmp_path / "a.mcap", packets, kind, rising=False))
    shown(source)
    assert source.skipped == 0


def test_images_behind_video_leave_none_of_it_inside(tmp_path: Path) -> None:
    video = [compressed(data, stamp(k), "h264") for k, data in STREAMS["h264 B"][1]()]
    images = [compressed(files(numbered(k), ".png"), stamp(k), "png") for k in range(COUNT, COUNT + 5)]
    source = McapImageSource(write_log(tmp_path / "a.mcap", {"/camera": logged([*video, *images])}))
    shown(source, count=COUNT + 5)
    assert source.skipped == 0


def test_video_with_lengths_is_named(tmp_path: Path) -> None:
    def lengths(data: bytes) -> bytes:
        units = [unit for unit in re.split(b"\0?\0\0\1", data) if unit]
        return b"".join(len(unit).to_bytes(4, "big") + unit for unit in units)

    packets = [(k, lengths(data)) for k, data in pictures.x264(COUNT, "bframes=0")]
    with pytest.raises(InputError, match=r"lengths in place of start codes \(AVCC\)"):
        list(McapImageSource(video_log(tmp_path / "a.mcap", packets, "h264", rising=True)))


def test_unknown_video_is_named(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.CompressedVideo", "jsonschema", b"{}")
        channel = writer.register_channel("/camera", "json", schema)
        message = b'{"timestamp":{"sec":5,"nsec":0},"format":"mpeg5","data":"AAAA"}'
        writer.add_message(channel, 5, message, 5)
        writer.finish()
    with pytest.raises(InputError, match="video format is not readable: 'mpeg5', only h264, h265, vp9, av1"):
        list(McapImageSource(tmp_path / "a.mcap"))


# Orientation


@pytest.mark.parametrize(("exif", "words"), [(6, "turned by 90 degrees clockwise"), (3, "turned by 180 degrees")])
def test_compressed_images_are_turned_upright(tmp_path: Path, exif: int, words: str) -> None:
    files = [saved(as_stored(numbered(k), exif), "PNG", exif) for k in range(3)]
    messages = [compressed(data, stamp(k), "png") for k, data in enumerate(files)]
    path = write_log(tmp_path / "a.mcap", {"/camera": logged(messages)})
    source = McapImageSource(path)
    shown(source, count=3)
    assert source.orientation == f"{words} (EXIF {exif})"
    assert source.notes == [
        f"images are {words} (EXIF {exif}), as their files say: --no-autorotate leaves them as stored"
    ]
    left = McapImageSource(path, autorotate=False)
    np.testing.assert_array_equal(next(iter(left)).image, as_stored(numbered(0), exif))
    assert left.orientation == f"as stored, not {words} (EXIF {exif})"
    assert not left.notes


# What a log is taken for


def test_info(tmp_path: Path) -> None:
    path = video_log(tmp_path / "drive.mcap", STREAMS["h264 B"][1](), "h264", rising=True)
    outcome = command(str(path), "--info")
    assert outcome.code == 0, outcome.err
    rows = dict(line.split(":", 1) for line in outcome.out.splitlines())
    rows = {name: value.strip() for name, value in rows.items()}
    assert rows["kind"] == "MCAP, /camera (sensor_msgs/msg/CompressedImage as cdr)"
    assert rows["size"] == "256x128 colour, 8 bits"
    assert (rows["frames"], rows["codec"], rows["rate"]) == (str(COUNT), "h264", "30 frames/s")
    assert rows["first time"].startswith("1700000000.123456789 s")
    assert rows["last time"].startswith(f"{stamp(COUNT - 1) * 1e-9:.3f}")


def test_info_of_a_bag_without_an_index(tmp_path: Path) -> None:
    from rosbags import rosbag1

    from tests.helpers.camera_messages import ROS1, ros1

    writer = rosbag1.Writer(tmp_path / "a.bag")
    with writer:
        camera = writer.add_connection("/camera", "sensor_msgs/msg/Image", typestore=ROS1)
        for k in range(5):
            image = numbered(k)
            fields = image_fields(image.tobytes(), *pictures.SIZE, "bgr8", image[0].nbytes)
            writer.write(camera, stamp(k), ros1("Image", stamp_ns=stamp(k), **fields))
    data = bytearray((tmp_path / "a.bag").read_bytes())
    place = data.index(b"index_pos=") + 10
    data[place : place + 8] = bytes(8)
    (tmp_path / "killed.bag").write_bytes(data)
    shown(open_images(tmp_path / "killed.bag"), count=5)
    outcome = command(str(tmp_path / "killed.bag"), "--info")
    assert outcome.code == 0, outcome.err
    assert re.search(r"kind: +ROS 1 bag without an index, /camera \(sensor_msgs/Image as ros1\)", outcome.out)
    assert re.search(r"frames: +5\n", outcome.out)
    assert re.search(r"codec: +bgr8\n", outcome.out)
