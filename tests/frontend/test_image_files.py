"""Image files as people have them: every format by its content, turned upright, several pictures in one file."""

from __future__ import annotations

import json
import struct
import sys
import zlib
from fractions import Fraction
from io import BytesIO
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from PIL import Image as Pillow

from airline.errors import ConfigError, InputError
from frontend.sources import open_source
from frontend.sources.folder import FolderSource
from frontend.sources.stills import decode_encoded, read_still
from tests.helpers.command import command
from tests.helpers.numbered import number_of, numbered, write_numbered

pillow_heif = pytest.importorskip("pillow_heif", reason="the extra heic")
LOSSLESS = {"WEBP": {"lossless": True}, "AVIF": {"quality": 95}, "JPEG": {"quality": 95}}
ORIENTED = ("JPEG", "PNG", "WEBP", "TIFF", "AVIF", "HEIF")


def saved(image: np.ndarray, form: str, exif: int = 1) -> bytes:
    """A file by Pillow, BGR or grey in."""
    data, tags = BytesIO(), Pillow.Exif()
    tags[274] = exif
    picture = Pillow.fromarray(np.ascontiguousarray(image[:, :, ::-1]) if image.ndim == 3 else image)
    if form == "HEIF":
        pillow_heif.from_pillow(picture).save(data, quality=95, exif=tags.tobytes())
        return data.getvalue()
    picture.save(data, form, **({"exif": tags} if exif != 1 else {}), **LOSSLESS.get(form, {}))
    return data.getvalue()


def as_stored(image: np.ndarray, exif: int) -> np.ndarray:
    """What is stored with this orientation, by the standard's words on where the stored row 0 and column 0 are seen."""
    stored = {
        1: image,  # top, left
        2: image[:, ::-1],  # top, right
        3: image[::-1, ::-1],  # bottom, right
        4: image[::-1],  # bottom, left
        5: image.swapaxes(0, 1),  # left, top
        6: image[:, ::-1].swapaxes(0, 1),  # right, top
        7: image[::-1, ::-1].swapaxes(0, 1),  # right, bottom
        8: image[::-1].swapaxes(0, 1),  # left, bottom
    }
    return np.ascontiguousarray(stored[exif])


@pytest.mark.parametrize("exif", range(1, 9))
@pytest.mark.parametrize("form", ORIENTED)
def test_orientation(tmp_path: Path, form: str, exif: int) -> None:
    stored = as_stored(numbered(37), exif)
    data = saved(stored, form, exif)
    if form not in ("HEIF", "AVIF"):  # an independent judge: OpenCV turns by EXIF when it makes colour images
        number_of(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
    image, header = read_still(data)
    assert (number_of(image), header.exif) == (37, exif)
    left = read_still(data, autorotate=False).image
    assert np.abs(left.astype(int) - stored).mean() < 4
    (tmp_path / "photo.jpg").write_bytes(data)
    for spec in (tmp_path, tmp_path / "photo.jpg", tmp_path / "*.jpg"):
        source = open_source(spec)
        (frame,) = source
        assert number_of(frame.image) == 37
        assert source.orientation == ("as stored" if exif == 1 else source.orientation)
        assert source.orientation.endswith(f"(EXIF {exif})") == (exif != 1)
        assert sum("--no-autorotate" in note for note in source.notes) == (exif != 1)
        source = open_source(spec, autorotate=False)
        (frame,) = source
        assert np.abs(frame.image.astype(int) - stored).mean() < 4
        assert not [note for note in source.notes if "turned" in note]


@pytest.mark.parametrize("form", ["TIFF"])
@pytest.mark.parametrize("exif", range(1, 9))
def test_orientation_of_16_bits(form: str, exif: int) -> None:
    stored = as_stored(numbered(21, grey=True).astype(np.uint16) * 200, exif)
    image = decode_encoded(saved(stored, form, exif))
    assert (number_of(image), image.dtype) == (21, np.uint16)


def test_images_that_are_turned_by_different_amounts(tmp_path: Path) -> None:
    for k, exif in enumerate((6, 6, 3, 1)):
        (tmp_path / f"{k}.jpg").write_bytes(saved(as_stored(numbered(k), exif), "JPEG", exif))
    source = open_source(tmp_path)
    assert [number_of(frame.image) for frame in source] == [0, 1, 2, 3]
    assert source.orientation == "turned by 90 degrees clockwise (EXIF 6)"
    assert sum("not all turned alike: the first are turned by 90" in note for note in source.notes) == 1


def test_damaged_exif_data_turn_nothing() -> None:
    data = saved(numbered(3), "JPEG", 6)
    start = data.index(b"Exif\0\0") + 6
    rng = np.random.default_rng(0)
    for _ in range(200):
        damaged = bytearray(data)
        damaged[start + int(rng.integers(20))] = int(rng.integers(256))
        assert read_still(bytes(damaged)).image.shape in ((48, 96, 3), (96, 48, 3))


def test_info_and_summary_tell_of_turned_images(tmp_path: Path) -> None:
    for k in range(2):
        (tmp_path / f"{k}.jpg").write_bytes(saved(as_stored(numbered(k), 8), "JPEG", 8))
    info = command(tmp_path, "--info")
    assert info.code == 0
    assert "orientation: turned by 90 degrees counterclockwise (EXIF 8)" in info.out
    assert "codec:       JPEG" in info.out
    assert "kind:        images\n" in info.out
    outcome = command(tmp_path, "--out", tmp_path / "t.csv", "--summary", tmp_path / "s.json")
    assert outcome.code == 0
    assert "note: images are turned by 90 degrees counterclockwise" in outcome.out
    summary = json.loads((tmp_path / "s.json").read_text())
    assert [note for note in summary["notes"] if "--no-autorotate" in note]
    assert "note: images are turned" not in command(tmp_path, "--info", "--no-autorotate").out


FORMS = ["JPEG", "PNG", "WEBP", "TIFF", "AVIF", "HEIF", "BMP", "PPM", "GIF"]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".HEIC", ".tif"])
@pytest.mark.parametrize("form", FORMS)
def test_content_tells_the_format(tmp_path: Path, form: str, suffix: str) -> None:
    path = tmp_path / f"photo{suffix}"
    path.write_bytes(saved(numbered(90), form))
    source = FolderSource(path)
    (frame,) = source
    assert number_of(frame.image) == 90
    assert source.codec == {"WEBP": "WebP", "HEIF": "HEIC", "PPM": "PNM"}.get(form, form)
    assert (source.kind, source.notes, source.skipped) == ("one image", [], 0)
    assert [number_of(frame.image) for frame in FolderSource(tmp_path)] == [90]


@pytest.mark.parametrize("form", FORMS)
def test_cut_and_damaged_files_are_refused_or_decoded(form: str, capfd: pytest.CaptureFixture[str]) -> None:
    data = saved(numbered(5), form)
    for length in range(0, len(data) - 40, max(1, len(data) // 40)):
        with pytest.raises(InputError):
            decode_encoded(data[:length])
    rng = np.random.default_rng(1)
    for _ in range(60):
        damaged = bytearray(data)
        damaged[int(rng.integers(min(len(data), 400)))] = int(rng.integers(256))
        try:
            image = read_still(bytes(damaged)).image
        except InputError:
            continue
        assert image.size <= 3 << 26


@pytest.mark.parametrize(
    "data",
    [
        struct.pack("<2sIHHIIiiHHIIiiII", b"BM", 54, 0, 0, 54, 40, 30000, 30000, 1, 24, 0, 0, 0, 0, 0, 0) + bytes(999),
        struct.pack("<2sIHHIIiiHHIIiiII", b"BM", 54, 0, 0, 54, 40, 8000, 8000, 1, 24, 0, 0, 0, 0, 0, 0) + bytes(999),
        b"P5 30000 30000 255\n" + bytes(999),
        struct.pack("<6sHHBBBBHHHHBB", b"GIF89a", 60000, 60000, 0, 0, 0, 0x2C, 0, 0, 9, 9, 0, 2) + bytes(999),
        struct.pack("<2sHIHHHIIHHIII", b"II", 42, 8, 2, 256, 4, 1, 30000, 257, 4, 1, 30000, 0) + bytes(999),
        struct.pack("<2sHIHHHIIHHIII", b"II", 42, 8, 2, 256, 4, 1, 8000, 257, 4, 1, 8000, 0) + bytes(999),
    ],
)
def test_sizes_that_lie(data: bytes) -> None:
    with pytest.raises(InputError, match=r"too large|too short"):
        decode_encoded(data)


def test_heic_without_libheif_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "IMG_1.HEIC").write_bytes(saved(numbered(1), "HEIF"))
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(ConfigError, match=r"pip install 'airline-frontend\[heic\]'"):
        list(FolderSource(tmp_path))


FORMS_OF_ANIMATIONS = [("GIF", ".gif"), ("PNG", ".png"), ("PNG", ".apng"), ("WEBP", ".webp"), ("AVIF", ".avif")]


def gif(pictures: list[np.ndarray], form: str, durations: list[int]) -> bytes:
    """An animation by Pillow; durations in ms."""
    data = BytesIO()
    first, *rest = (Pillow.fromarray(np.ascontiguousarray(picture[:, :, ::-1])) for picture in pictures)
    first.save(data, form, save_all=True, append_images=rest, duration=durations, **LOSSLESS.get(form, {}))
    return data.getvalue()


@pytest.mark.parametrize(("form", "suffix"), FORMS_OF_ANIMATIONS)
def test_animations(tmp_path: Path, form: str, suffix: str) -> None:
    durations = [40 + 10 * (k % 3) for k in range(20)]
    path = tmp_path / f"clip{suffix}"
    path.write_bytes(gif([numbered(k) for k in range(20)], form, durations))
    source = FolderSource(path)
    frames = list(source)
    assert [number_of(frame.image) for frame in frames] == list(range(20))
    expected = [sum(durations[:k]) * 10**6 for k in range(20)]
    assert [frame.stamp_ns for frame in frames] == expected
    assert [frame.index for frame in frames] == list(range(20))
    assert len({frame.name for frame in frames}) == 20
    assert source.kind == f"animated {source.codec} of 20 pictures"
    assert (source.frame_count, source.last_stamp_ns, source.notes) == (20, expected[-1], [])
    source = FolderSource(path)
    source.seek(expected[7] / 1e9)
    assert [number_of(frame.image) for frame in source] == list(range(7, 20))
    source = FolderSource(tmp_path)  # among others it is one picture
    assert [number_of(frame.image) for frame in source] == [0]
    assert sum("files with several pictures, of which the first is taken" in note for note in source.notes) == 1


def test_a_damaged_animation_gives_what_is_before(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    data = bytearray(gif([numbered(k) for k in range(11)], "WEBP", [40] * 11))
    seventh = [place for place in range(len(data)) if data[place : place + 4] == b"VP8L"][6] + 8
    data[seventh + 5 : seventh + 40] = bytes([255]) * 35
    (tmp_path / "clip.webp").write_bytes(data)
    source = FolderSource(tmp_path / "clip.webp")
    frames = list(source)
    assert [number_of(frame.image) for frame in frames] == list(range(6))
    assert source.notes == ["the file is cut or damaged after 6 of its 11 pictures"]
    assert source.notes[0] in caplog.text


def test_a_picture_that_is_larger_than_its_animation(tmp_path: Path) -> None:
    data = bytearray(gif([numbered(k) for k in range(3)], "GIF", [40] * 3))
    third = [place for place in range(len(data)) if data[place : place + 2] == b"\0\x2c"][2] + 2
    struct.pack_into("<HHHH", data, third, 0, 0, 8500, 8500)
    (tmp_path / "clip.gif").write_bytes(data)
    assert [number_of(frame.image) for frame in FolderSource(tmp_path / "clip.gif")] == [0, 1]


def test_an_animated_png_with_a_picture_of_its_own(tmp_path: Path) -> None:
    """Which is for programs that know no animations."""
    first, *rest = (Pillow.fromarray(numbered(k)) for k in range(5))
    first.save(tmp_path / "a.png", save_all=True, append_images=rest, default_image=True, duration=40)
    assert [number_of(frame.image) for frame in FolderSource(tmp_path / "a.png")] == [1, 2, 3, 4]


def test_durations_of_an_animated_png_are_exact(tmp_path: Path) -> None:
    path = tmp_path / "clip.png"
    with av.open(str(path), "w", format="apng") as container:
        stream = container.add_stream("apng", rate=Fraction(30000, 1001))
        stream.width, stream.height, stream.pix_fmt = 96, 48, "rgb24"
        for k in range(31):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(numbered(k), format="bgr24")))
        container.mux(stream.encode())
    frames = list(FolderSource(path))
    assert [number_of(frame.image) for frame in frames] == list(range(31))
    assert abs(frames[30].stamp_ns - 30 * 1001 / 30000 * 1e9) < 31


def test_pictures_without_a_duration(tmp_path: Path) -> None:
    (tmp_path / "clip.gif").write_bytes(gif([numbered(k) for k in range(4)], "GIF", [0] * 4))
    source = FolderSource(tmp_path / "clip.gif")
    assert [frame.stamp_ns for frame in source] == [0, 10**8, 2 * 10**8, 3 * 10**8]
    assert sum("100 ms" in note for note in source.notes) == 1


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("compression", [1, 5, 8])
def test_pages_of_a_tiff(tmp_path: Path, bits: int, compression: int) -> None:
    pages = [numbered(k).astype(f"u{bits // 8}") * (1 if bits == 8 else 200) for k in range(20)]
    done, data = cv2.imencodemulti(".tiff", pages, (cv2.IMWRITE_TIFF_COMPRESSION, compression))
    assert done
    path = tmp_path / "stack.tif"
    path.write_bytes(data.tobytes())
    source = FolderSource(path, fps=16)
    frames = list(source)
    assert [number_of(frame.image) for frame in frames] == list(range(20))
    assert [frame.stamp_ns for frame in frames] == [k * 62_500_000 for k in range(20)]
    assert {frame.image.dtype.itemsize for frame in frames} == {bits // 8}
    assert source.kind == "TIFF of 20 pages"
    assert source.notes == ["the file's 20 pages are numbered by 16 frames/s: --fps gives another rate"]
    for k in range(3):
        (tmp_path / f"more{k}.tif").write_bytes(data.tobytes())
    source = FolderSource(tmp_path)
    assert [number_of(frame.image) for frame in source] == [0] * 4
    assert [note for note in source.notes if "several pictures" in note] == [
        "files with several pictures, of which the first is taken: 4; give one file for all"
    ]


def test_pages_and_their_orientations_and_thumbnails(tmp_path: Path) -> None:
    data = BytesIO()
    pages = [Pillow.fromarray(as_stored(numbered(k), 6)) for k in range(4)]
    pages[2].encoderinfo = {"tiffinfo": {254: 1}}  # a thumbnail
    pages[0].save(data, "TIFF", save_all=True, append_images=pages[1:], tiffinfo={274: 6})
    path = tmp_path / "stack.tif"
    path.write_bytes(data.getvalue())
    frames = list(FolderSource(path))
    assert [number_of(frame.image) for frame in frames] in ([0, 1, 3], [0, 1, 2, 3])


def test_a_circle_of_pages_ends(tmp_path: Path) -> None:
    data = bytearray(cv2.imencodemulti(".tiff", [numbered(0), numbered(1)])[1].tobytes())
    (first,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, first)
    struct.pack_into("<I", data, first + 2 + 12 * count, first)
    (tmp_path / "a.tif").write_bytes(data)
    assert [number_of(frame.image) for frame in FolderSource(tmp_path / "a.tif")] == [0]


@pytest.mark.parametrize("kind", ["float32", "float64", "int16", "int32"])
def test_measured_values_are_told(tmp_path: Path, kind: str) -> None:
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"{k}.tiff"), numbered(k, grey=True).astype(kind))
    outcome = command(tmp_path, "--headless")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1 + outcome.err.count("skipped"))
    assert f"pixels are {'measured values of ' if 'float' in kind else ''}{kind}, convert them to" in outcome.err


def test_reasons_of_what_is_skipped(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_numbered(tmp_path, [f"{k}.png" for k in range(6)])
    (tmp_path / "1.png").write_bytes(b"no image")
    (tmp_path / "3.png").write_bytes((tmp_path / "3.png").read_bytes()[:90])
    cv2.imwrite(str(tmp_path / "4.tiff"), numbered(4, grey=True).astype(np.float32))
    source = FolderSource(tmp_path)
    assert [number_of(frame.image) for frame in source] == [0, 2, 4, 5]
    for words in ("1 x no image file that is known", "1 x cut or damaged image", "measured values of float32"):
        assert words in caplog.text


def test_a_png_chunk_is_not_turned_twice() -> None:
    """A chunk with EXIF data before and after the pixels."""
    data = saved(as_stored(numbered(9), 6), "PNG", 6)
    kind = b"eXIf"
    place = data.index(kind) - 4
    (length,) = struct.unpack_from(">I", data, place)
    chunk = data[place : place + 12 + length]
    assert zlib.crc32(chunk[4:-4]) == struct.unpack(">I", chunk[-4:])[0]
    assert number_of(decode_encoded(data[: data.index(b"IEND") - 4] + chunk + data[data.index(b"IEND") - 4 :])) == 9
