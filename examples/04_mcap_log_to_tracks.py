"""Track the lines of an MCAP log into files: `python examples/04_mcap_log_to_tracks.py [--topic TOPIC] [LOG.mcap]`.

Writes LOG_tracks.parquet and LOG_tracks.mcap into the current folder. Without LOG.mcap a short log is made of the
built-in clip in a temporary folder, and its tracks go there too. For ROS bags take `logs.open_images` as the source.
"""

import argparse
import sys
import tempfile
from collections import Counter
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from airline import AirLineError
from airline.scenes import RenderedClip
from frontend import LineFrontend
from frontend.sources.scene import SceneSource
from logs import McapImageSource, McapTrackSink, ParquetTrackSink

START_NS = 1_700_000_000_000_000_000  # of the clip: a log's clock counts from 1970


def make_log(path: Path) -> Path:
    """A log with the images and the calibration of the built-in clip; the sink writes them when asked to."""
    frontend = LineFrontend()
    with closing(McapTrackSink(path, with_images=True)) as sink:
        for frame in SceneSource(RenderedClip(seed=12, frames=12)):
            sink.write(frontend.process(replace(frame, stamp_ns=frame.stamp_ns + START_NS)))
    return path


parser = argparse.ArgumentParser(description="Track the lines of an MCAP log into Parquet and MCAP.")
parser.add_argument("--topic", help="the image topic; may be left out if there is only one")
parser.add_argument("--overwrite", action="store_true", help="replace the files of an earlier run")
parser.add_argument("log", nargs="?", type=Path, metavar="LOG.mcap")
options = parser.parse_args()

folder = Path() if options.log else Path(tempfile.mkdtemp())
frames, seen, confirmed = 0, Counter(), set()
try:
    log = options.log or make_log(folder / "clip.mcap")
    parquet, mcap = (folder / f"{log.stem}_tracks{suffix}" for suffix in (".parquet", ".mcap"))
    with (
        closing(McapImageSource(log, options.topic)) as source,
        closing(ParquetTrackSink(parquet, overwrite=options.overwrite)) as table,
        closing(McapTrackSink(mcap, overwrite=options.overwrite)) as messages,
    ):
        for result in LineFrontend().results(source):
            table.write(result)
            messages.write(result)
            frames += 1
            seen.update(result.tracks.ids.tolist())
            confirmed.update(result.tracks.ids[result.tracks.confirmed].tolist())
except AirLineError as error:
    sys.exit(str(error))

print(f"frames: {frames}, and {source.skipped} that cannot be read")
print(f"tracks: {len(seen)}, of which {len(confirmed)} were seen often enough to be trusted")
print(f"observations: {seen.total()}")
for track, length in seen.most_common(3):
    print(f"track {track} was seen in {length} frames")
print(f"wrote {parquet}", f"wrote {mcap}", sep="\n")
