"""What `tests.helpers.fuzz` feeds: every reader of files and messages of strangers, with sound samples."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path

import cv2
import numpy as np
import zstandard
from mcap.writer import CompressionType
from rosbags import rosbag1

from airline.network.spec import UNetSpec
from airline.network.weights import load_ranges, load_weights
from frontend.camera.calibration import read_calibration
from frontend.cli.settings import RunConfig, dump, load
from frontend.protocols import FrameResult
from frontend.sources.reading import UndecodableError
from frontend.sources.stills import read_still
from logs import read_tracks
from logs.files.bag_scan import UnindexedBag
from logs.files.mcap_file import McapFile
from logs.images.decoder import decode_still
from logs.messages.readers import reader_for
from logs.messages.types import EncodedImage, RawImage
from logs.sinks.foxglove import McapTrackSink
from logs.sinks.tables import ParquetTrackSink
from logs.tracks.json import decode_tracks, encode_tracks
from logs.tracks.message import decode
from tests.frontend import test_calibration as calibrations
from tests.helpers.camera_messages import ROS1
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
        "bag without an index": of_file(_bags(folder), "b.bag", _read_bag),
        "compressed message": _compressed_message(),
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


def _bags(folder: Path) -> list[bytes]:
    """A small bag of ROS 1 in each compression whose header knows of no index."""
    found = []
    for compression in (None, *rosbag1.Writer.CompressionFormat):
        path = folder / f"sample{compression}.bag"
        writer = rosbag1.Writer(path)
        if compression is not None:
            writer.set_compression(compression)
        with writer:
            camera = writer.add_connection("/camera", "sensor_msgs/msg/Image", typestore=ROS1)
            for number in range(3):
                writer.write(camera, 10**18 + number, bytes([number]) * 60)
        data = path.read_bytes()
        place = data.index(b"index_pos=") + 10
        found.append(data[:place] + bytes(8) + data[place + 8 :])
    return found


def _read_bag(path: Path) -> None:
    with closing(UnindexedBag(path)) as bag:
        for topic in bag.topics:
            for _ in bag.messages(topic):
                pass


def _compressed_message() -> Target:
    schema = "sensor_msgs/msg/Image", "cdr"
    (message,), read = _message(*schema)
    return [zstandard.ZstdCompressor(write_content_size=says).compress(message) for says in (True, False)], read


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
