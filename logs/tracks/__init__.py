"""Tracked lines as JSON and as tables."""
