"""What `tests.helpers.fuzz` feeds: every reader of files and messages of strangers, with sound samples."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

import cv2
import numpy as np
from mcap.writer import CompressionType

from airline.network.spec import UNetSpec
from airline.network.weights import load_ranges, load_weights
from frontend.camera.calibration import read_calibration
from frontend.cli.settings import RunConfig, dump, load
from frontend.protocols import FrameResult
from frontend.sources.reading import UndecodableError
from frontend.sources.stills import read_still
from logs import read_tracks
from logs.files.mcap_file import McapFile
from logs.images.decoder import decode_still
from logs.messages.readers import reader_for
from logs.messages.types import EncodedImage, RawImage
from logs.sinks.foxglove import McapTrackSink
from logs.sinks.tables import ParquetTrackSink
from logs.tracks.json import decode_tracks, encode_tracks
from logs.tracks.message import decode
from tests.frontend import test_calibration as calibrations
from tests.helpers.made_tracks import made_tracks, result_of, write_tracks
from tests.helpers.mcap_logs import messages, write
from tests.logs.test_live_message import encoded
from tests.logs.test_log_messages import MESSAGES

Target = tuple[list[bytes], Callable[[bytes], object]]


def all_targets(folder: Path) -> dict[str, Target]:
    """Targets by name; files go into the folder."""

    def of_file(samples: list[bytes], name: str, read: Callable[[Path], object]) -> Target:
        path = folder / name
        return samples, lambda data: (path.write_bytes(data), read(path))

    return {
        **{f"message {schema} {encoding}": _message(schema, encoding) for schema, encoding in MESSAGES},
        "live message": ([encoded()], decode),
        "tracks in JSON": ([encode_tracks(_frame(3))], decode_tracks),
        "image file": (_image_files(), _read_still),
        "settings": of_file([dump(RunConfig()).encode()], "s.toml", lambda path: load(path, {})),
        "calibration": of_file(_calibrations(), "c.yaml", lambda path: read_calibration(path, "image_2")),
        "weights": of_file([_weights()], "w.safetensors", lambda path: (load_weights(path), load_ranges(path))),
        "log": of_file(_logs(folder), "l.mcap", _read_log),
        "tracks in MCAP": of_file(_tracks(folder / "t.mcap"), "d.mcap", _read_tracks),
        "tracks in Parquet": of_file(_tracks(folder / "t.parquet"), "d.parquet", _read_tracks),
        "journal": of_file(_journal(folder / "j.parquet"), "d.parquet.unfinished", _read_tracks),
    }


def _message(schema: str, encoding: str) -> Target:
    reader = reader_for(schema, encoding)
    assert reader is not None

    def read(data: bytes) -> None:
        with suppress(UndecodableError):
            record = reader(data)
            if isinstance(record, (RawImage, EncodedImage)):
                decode_still(record)

    return [MESSAGES[schema, encoding]], read


def _frame(number: int, rows: int = 5):
    return made_tracks(number, number * 10**7, np.arange(rows), np.random.default_rng(number), lost=1)


def _read_still(data: bytes) -> None:
    with suppress(UndecodableError):
        read_still(data)


def _image_files() -> list[bytes]:
    image = cv2.resize(np.random.default_rng(0).integers(0, 256, (6, 8, 3), np.uint8), (32, 24))
    suffixes = (".png", ".jpg", ".webp", ".bmp", ".tiff", ".pgm", ".ppm", ".gif", ".avif")
    return [cv2.imencode(suffix, image[:, :, 0] if suffix == ".pgm" else image)[1].tobytes() for suffix in suffixes]


def _calibrations() -> list[bytes]:
    names = ("EUROC", "KALIBR", "ROS", "OPENCV", "JSON", "KITTI", "KITTI_RAW", "ICL", "SCANNET", "TUM", "DSO")
    return [getattr(calibrations, name).encode() for name in names]


def _weights() -> bytes:
    """Of a tiny network."""
    from safetensors.numpy import save

    spec = UNetSpec((1,))
    metadata = {**spec.to_metadata(), "ranges": '{"head": [0, 1]}'}
    return save({name: np.zeros(shape, np.float32) for name, shape in spec.shapes().items()}, metadata)


def _logs(folder: Path) -> list[bytes]:
    """Short logs in every compression, with and without chunks and checksums."""
    found = []
    for compression in CompressionType:
        for options in ({"enable_crcs": True}, {"enable_crcs": False}, {"use_chunking": False}):
            path = write(folder / "sample.mcap", messages(9), compression=compression, chunk_size=300, **options)
            found.append(path.read_bytes())
    return found


def _read_log(path: Path) -> None:
    with closing(McapFile(path)) as log:
        for topic in log.topics:
            for _ in log.messages(topic):
                pass


def _tracks(path: Path) -> list[bytes]:
    """The file with four frames, every second one without tracks."""
    write_tracks(McapTrackSink(path) if path.suffix == ".mcap" else ParquetTrackSink(path), _results())
    return [path.read_bytes()]


def _journal(path: Path) -> list[bytes]:
    """What a run that was killed leaves."""
    with closing(ParquetTrackSink(path)) as sink:
        for result in _results():
            sink.write(result)
        sink.flush()
        return [path.with_name(f"{path.name}.unfinished").read_bytes()]


def _results() -> list[FrameResult]:
    return [result_of(_frame(number, 3 * (number % 2))) for number in range(4)]


def _read_tracks(path: Path) -> None:
    for tracks in read_tracks(path):
        assert len(tracks.segments_px) == len(tracks)
