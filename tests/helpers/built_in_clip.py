"""The built-in clip: what it is a video of, and `python -m tests.helpers.built_in_clip`, which renders it anew."""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

import av
import numpy as np
from scipy.spatial.transform import Rotation

from airline.scenes import RenderedClip, RenderedView, render_pairs
from frontend.sources.scene import CAMERAS, CLIP, beside, frame_of

QUALITY = {"crf": "20", "preset": "slow", "g": "60", "threads": "1"}


def built_in_clip() -> RenderedClip:
    """What the built-in clip is a video of, with all of its truth."""
    return RenderedClip(kind="indoor", motion="handheld", seed=12, frames=300)


def write_clip(pairs: Iterable[tuple[RenderedView, RenderedView]], video: Path) -> None:
    """Write rendered views of 640x480 px at 30 frames/s as two H.264 videos, and the truth beside them."""
    rows = []
    with ExitStack() as stack:
        files = [stack.enter_context(av.open(str(beside(video, of)), "w")) for of in CAMERAS]
        streams = [file.add_stream("libx264", rate=30, options=QUALITY) for file in files]
        for stream in streams:
            stream.width, stream.height, stream.pix_fmt = 640, 480, "yuv420p"
        for index, pair in enumerate(pairs):
            for file, stream, view in zip(files, streams, pair, strict=True):
                file.mux(stream.encode(av.VideoFrame.from_ndarray(view.image, format="bgr24")))
            pose = pair[0].pose
            rows.append((pair[0].stamp_ns * 1e-9, *pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()))
            camera = frame_of(index, *pair).camera
        for file, stream in zip(files, streams, strict=True):
            file.mux(stream.encode())
    assert camera is not None
    numbers = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    for of, x in zip(CAMERAS, (0.0, camera.baseline_m), strict=True):
        place = [[1, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        text = json.dumps({**numbers, "rig_from_camera": place}, indent=2)
        beside(video, of, "camera.json").write_text(text + "\n")
    np.savetxt(video.with_name("poses.txt"), rows, fmt="%.9f", header="time x y z qx qy qz qw, world from camera")


if __name__ == "__main__":
    write_clip(render_pairs(built_in_clip()), CLIP)
