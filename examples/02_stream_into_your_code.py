"""Track lines in a stream and use the tracks: `python examples/02_stream_into_your_code.py [INPUT]`.

INPUT is a video file, an image folder or glob, a camera index or a stream URL; without it the built-in clip runs.
"""

import sys

from airline.scenes import RenderedClip
from frontend import LineFrontend
from frontend.sources.scene import SceneSource

source = sys.argv[1] if len(sys.argv) > 1 else SceneSource(RenderedClip(seed=12, frames=20))
for tracks in LineFrontend().stream(source):
    confirmed = tracks.confirmed
    # your backend's call goes here: stamp, ids and end points of the lines that were seen often enough
    print(tracks.stamp_ns, tracks.ids[confirmed][:8], tracks.segments_px[confirmed].shape)
