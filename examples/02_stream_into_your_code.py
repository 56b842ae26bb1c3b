"""Track lines in a stream and use the tracks: `python examples/02_stream_into_your_code.py [INPUT]`.

INPUT is a video file, an image folder or glob, a camera index or a stream URL; without it the built-in clip runs.
"""

import sys

from frontend import LineFrontend
from frontend.sources.scene import CLIP

source = sys.argv[1] if len(sys.argv) > 1 else CLIP
for tracks in LineFrontend().stream(source):
    # tracks that were seen often enough: in this frame, and before it what earlier frames saw of those that are new
    for seen in (*tracks.history, tracks.take(tracks.confirmed)):
        # your backend's call goes here: stamp, ids, end points as measured in that frame, and how sure they are
        print(seen.stamp_ns, seen.ids[:8], seen.observed_px.shape, seen.observed_covariances.shape)
    print(f"frame {tracks.frame_index}: landmarks for {tracks.stable.sum()} tracks, {len(tracks.ended_ids)} ended")
