"""Track lines in many logs: `python examples/11_batch_over_many_logs.py [FOLDER [OUT]]`.

FOLDER holds the recordings, OUT (default: results) will hold what comes of them; without arguments two short videos
and a broken log are made in a temporary folder. On the command line: `python -m frontend.batch 'FOLDER/*' --out OUT`.
"""

import sys
import tempfile
from pathlib import Path

import pyarrow.parquet as pq

from airline.scenes import RenderedClip
from frontend.batch import run_batch
from viz.overlay import write_film


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
            for seed in (12, 13):
                views = RenderedClip(seed=seed, frames=10, size=(320, 240))
                write_film(logs / f"drive{seed}.mp4", (view.image for view in views), fps=30)
            (logs / "broken.mcap").write_bytes(b"not a log")
            main(logs, Path(temporary, "results"))
