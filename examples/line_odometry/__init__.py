"""Line odometry and line mapping from tracked lines: what a backend does with what the frontend gives it.

Read `odometry` first; it stands on `views` (what was seen), `triangulation` and `pose` (on the residual of `images`),
and `smoother` (GTSAM, with the factors of `residual`).
"""
