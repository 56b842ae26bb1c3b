"""Line odometry and line mapping from tracked lines: what a backend does with what the frontend gives it.

Read `odometry` first, then `mapping`; both stand on `views` (what was seen), `triangulation`, `adjust` and `geometry`.
"""
