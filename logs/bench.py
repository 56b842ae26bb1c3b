"""How fast logs are read: `python -m logs.bench`."""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import cycle, islice
from pathlib import Path

import cv2
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from airline.command import Parser, write_json
from frontend.sources.opencv import Image
from frontend.sources.scene import SceneSource
from logs import McapImageSource
from logs.files import open_log
from logs.images.decoder import ImageDecoder
from logs.messages.registry import reader_for
from logs.messages.types import CameraInfo, Record

TOPIC = "/camera"
DISTINCT = 20  # rendered pictures, repeated
ROUNDS = 5
SIZE = 640, 480


def write_log(path: Path, pictures: list[Image], frames: int, jpeg: bool, compression: CompressionType) -> None:
    """A ROS 2 log of `frames` messages that repeat the pictures."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    name = f"sensor_msgs/msg/{'CompressedImage' if jpeg else 'Image'}"
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start("ros2")
        schema = writer.register_schema(name, "ros2msg", store.generate_msgdef(name)[0].encode())
        channel = writer.register_channel(TOPIC, "cdr", schema)
        for number, picture in enumerate(islice(cycle(pictures), frames)):
            stamp = store.types["builtin_interfaces/msg/Time"](sec=1 + number // 30, nanosec=number % 30 * 33_000_000)
            header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="camera")
            if jpeg:
                encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
                message = store.types[name](header=header, format="jpeg", data=encoded)
            else:
                height, width = picture.shape
                message = store.types[name](
                    header=header,
                    height=height,
                    width=width,
                    encoding="mono8",
                    is_bigendian=0,
                    step=width,
                    data=picture.reshape(-1),
                )
            data = bytes(store.serialize_cdr(message, name))
            writer.add_message(channel, log_time=10**9 + number * 33_000_000, data=data, publish_time=0)
        writer.finish()


def steps(path: Path) -> dict[str, Callable[[], object]]:
    """What reading is made of; each step does all before it too, one after the other in one thread."""

    def records() -> Iterator[Record]:
        with closing(open_log(path)) as log:
            for message in log.messages(TOPIC):
                read = reader_for(message.type.schema_name, message.type.encoding)
                assert read is not None
                yield read(message.data)

    def chunks() -> None:
        with closing(open_log(path)) as log:
            for _ in log.messages(TOPIC):
                pass

    def messages() -> None:
        for _ in records():
            pass

    def images() -> None:
        decoder = ImageDecoder()
        for record in records():
            assert not isinstance(record, CameraInfo)
            decoder.decode(record)

    return {"file": chunks, "message": messages, "image": images}


def measure(path: Path, frames: int) -> dict[str, float]:
    """Frames per second of the source, and microseconds per frame of each step alone; medians of interleaved rounds."""
    work: dict[str, Callable[[], object]] = {**steps(path), "source": lambda: sum(1 for _ in McapImageSource(path))}
    spent: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(ROUNDS):
        for name, step in work.items():
            started = time.perf_counter()
            step()
            spent[name].append((time.perf_counter() - started) / frames)
    median = {name: statistics.median(times) for name, times in spent.items()}
    return {
        "fps": 1 / median["source"],
        "file_us": 1e6 * median["file"],
        "message_us": 1e6 * max(median["message"] - median["file"], 0),
        "image_us": 1e6 * max(median["image"] - median["message"], 0),
    }


def as_text(results: dict[str, dict[str, float]]) -> str:
    """The figures as aligned columns."""
    lines = [f"{'640x480':14}{'frames/s':>9}  time of each step alone, in one thread"]
    for name, figures in results.items():
        parts = {step: figures[f"{step}_us"] for step in ("file", "message", "image")}
        total = sum(parts.values())
        shares = ", ".join(f"{step} {spent:.0f} us ({100 * spent / total:.0f} %)" for step, spent in parts.items())
        lines.append(f"{name:14}{figures['fps']:9.0f}  {shares}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = Parser(prog="python -m logs.bench", description=__doc__)
    parser.add_argument("--frames", type=int, default=400, metavar="N", help="messages per log (default: %(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures as JSON")
    options = parser.parse_args(arguments)
    if options.frames < 1:
        parser.error("--frames must be 1 or more")
    pictures = [frame.image for frame in islice(SceneSource(), DISTINCT)]
    colour = [cv2.resize(picture, SIZE) for picture in pictures]
    grey = [cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) for picture in colour]
    none, zstd = CompressionType.NONE, CompressionType.ZSTD
    kinds = {
        "jpeg": (colour, True, none),
        "mono8": (grey, False, none),
        "mono8 in zstd": (grey, False, zstd),
    }
    results = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (images, jpeg, compression) in kinds.items():
            path = Path(folder) / "log.mcap"
            write_log(path, images, options.frames, jpeg, compression)
            results[name] = measure(path, options.frames)
    print(as_text(results))
    write_json(options.json, results)
    return 0


if __name__ == "__main__":
    sys.exit(main())
