"""Look into tracks in Parquet, cell by cell: `python examples/07_tracks_from_parquet.py [TRACKS.parquet]`.

The `# %%` cells run one by one in VS Code, Spyder or, by jupytext, in Jupyter. TRACKS.parquet is a file of
`python -m frontend.run --out TRACKS.parquet`; without it a small one is written into a temporary folder.
"""

# %% A file with tracks
import sys
import tempfile
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from airline import AirLineError
from airline.scenes import RenderedClip
from frontend import LineFrontend
from frontend.sources.scene import SceneSource
from logs import ParquetTrackSink, read_tracks

notebook = hasattr(sys, "ps1")  # where the arguments are not ours: set the path here
path = Path(sys.argv[1]) if len(sys.argv) > 1 and not notebook else None
if path is None:
    path = Path(tempfile.mkdtemp()) / "tracks.parquet"
    with closing(ParquetTrackSink(path)) as sink:
        for result in LineFrontend().results(SceneSource(RenderedClip(seed=12, frames=12))):
            sink.write(result)

# %% Frame by frame, with all that was known: the LineTracks as they were written, bit by bit
frames = observations = confirmed = 0
try:
    for tracks in read_tracks(path):
        frames += 1
        observations += len(tracks)
        confirmed += np.count_nonzero(tracks.confirmed)
    table = pq.read_table(path)  # for the cells below
except (AirLineError, pa.ArrowInvalid) as error:  # read_tracks takes MCAP files too
    sys.exit(f"{path} is no Parquet file with tracks: {error}")
print(f"{path}: {frames} frames, {observations} observations, {confirmed} of them of confirmed tracks")

# %% As a table, for pandas, polars, DuckDB and the like: a row per observation; the file says what its columns mean
for field in table.schema:
    note = {key.decode(): text.decode() for key, text in field.metadata.items()}
    print(f"{field.name:17} {field.type!s:20} {note.get('unit', ''):7} {note['description']}")
for name in (b"pixels", b"segments", b"normalized", b"times"):
    print(f"{name.decode()}: {table.schema.metadata[name].decode()}")

# %% The longest tracks: rows grouped by id, and counted
lengths = table.group_by("id").aggregate([("frame", "count"), ("frame", "min"), ("frame", "max")])
lengths = lengths.sort_by([("frame_count", "descending"), ("id", "ascending")])
for row in lengths.slice(0, 5).to_pylist():
    print(f"track {row['id']}: {row['frame_count']} frames, from {row['frame_min']} to {row['frame_max']}")

# %% How long tracks are: a histogram whose bins double
counts = np.bincount(np.log2(lengths["frame_count"]).astype(int))
for k, count in enumerate(counts):
    print(f"{2**k:5} to {2 ** (k + 1) - 1:5} frames: {count:6} tracks {'#' * round(50 * count / counts.max())}")

# %% The longest track over time: its middle in pixels, and the standard deviation of its offset across itself
if len(lengths):
    track = table.filter(pc.field("id") == lengths["id"][0])
    x, y = ((track[f"{c}0"].to_numpy() + track[f"{c}1"].to_numpy()) / 2 for c in "xy")
    seconds = (track["stamp_ns"].to_numpy() - track["stamp_ns"][0].as_py()) / 1e9
    rows = list(zip(seconds, x, y, np.sqrt(track["var_offset"].to_numpy()), strict=True))
    for row in rows[:: max(1, len(rows) // 10)]:
        print("{:8.3f} s  ({:7.2f}, {:7.2f})  +- {:.3f} px".format(*row))

# %% The hundred longest as one numpy array: (tracks, frames, 2, 2) end points in pixels, NaN where a track is not seen
ids = np.sort(lengths["id"][:100].to_numpy())
part = table.filter(pc.is_in(table["id"], lengths["id"][:100]))
numbers, column = np.unique(part["frame"], return_inverse=True)
matrix = np.full((len(ids), len(numbers), 2, 2), np.nan, np.float32)
points = np.stack([part[name].to_numpy() for name in ("x0", "y0", "x1", "y1")], axis=1)
matrix[np.searchsorted(ids, part["id"]), column] = points.reshape(-1, 2, 2)
print(f"track matrix {matrix.shape}: {np.isfinite(matrix).mean():.0%} of it seen")
