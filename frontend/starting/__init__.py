"""What `frontend.start` is made of."""
