"""Track lines in many logs: `python examples/11_batch_over_many_logs.py [FOLDER [OUT]]`.

FOLDER holds the recordings, OUT (default: results) will hold what comes of them; without arguments three short logs and
a broken one are made in a temporary folder. On the command line: `python -m frontend.batch 'FOLDER/*' --out OUT`.
"""

import base64
import json
import sys
import tempfile
from pathlib import Path

import cv2
import pyarrow.parquet as pq
from mcap.writer import Writer

from airline.scenes import RenderedClip
from frontend.batch import run_batch
from frontend.sources.scene import SceneSource

START_NS = 1_700_000_000 * 10**9


def write_log(path: Path, seed: int) -> None:
    """A camera log as Foxglove's tools write them, with JPEG images of the built-in clip."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.CompressedImage", "jsonschema", b"{}")
        channel = writer.register_channel("/camera/image", "json", schema)
        for frame in SceneSource(RenderedClip(seed=seed, frames=10, size=(320, 240))):
            jpeg = base64.b64encode(cv2.imencode(".jpg", frame.image)[1]).decode()
            stamp_ns = START_NS + frame.stamp_ns
            stamp = {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9}
            message = {"timestamp": stamp, "frame_id": "camera", "format": "jpeg", "data": jpeg}
            writer.add_message(channel, stamp_ns, json.dumps(message).encode(), stamp_ns)
        writer.finish()


def main(folder: Path, out: Path) -> None:
    run_batch([folder / "*"], out)
    report = pq.read_table(out / "report.parquet")
    print("columns:", ", ".join(report.column_names))
    for row in report.to_pylist():
        print(row["name"], row["status"], row["reason"] or f"{row['frames']} frames, {row['tracks']} tracks")
    print("frames in all:", sum(filter(None, report["frames"].to_pylist())))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]), Path(*sys.argv[2:3] or ["results"]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            logs = Path(temporary, "logs")
            logs.mkdir()
            for seed in (12, 13, 14):
                write_log(logs / f"drive{seed}.mcap", seed)
            (logs / "broken.mcap").write_bytes(b"not a log")
            main(logs, Path(temporary, "results"))
