"""Track lines in a live camera: `python examples/08_live_camera.py [INDEX_OR_URL]`.

INDEX_OR_URL is a camera's number or a stream's URL; without it the built-in clip is played at a camera's pace.
"""

import sys

from frontend import LineFrontend, open_source
from frontend.sources.pace import FreshFrames, RealtimeSource
from frontend.sources.scene import BuiltInClip
from frontend.sources.wrapped import Peeked, SelectedFrames

camera = open_source(sys.argv[1]) if sys.argv[1:] else RealtimeSource(SelectedFrames(BuiltInClip(), max_frames=90))
fresh = FreshFrames(camera, prepares=True)  # drops the oldest frames when the camera is faster than we are
frontend = LineFrontend()
try:
    frames = Peeked(fresh)
    if frames.first is not None:
        frontend.warm_up(frames.first.image)
    for result in frontend.results(frames):
        confirmed = result.tracks.confirmed.sum()
        print(f"{result.tracks.stamp_ns / 1e9:.3f} s: {confirmed} confirmed tracks, {result.latency_ms:.1f} ms")
except KeyboardInterrupt:
    pass
finally:
    fresh.close()
print(f"{fresh.dropped} frames dropped")
