"""Two cameras side by side: rectified pairs, the partner of a tracked line in the right image, its place in metres."""
