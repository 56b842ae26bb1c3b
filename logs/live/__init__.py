"""Tracked lines into other processes while they are made, and the reader of such a stream."""
