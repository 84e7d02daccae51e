"""Markers in a frame: acquisition, sub-pixel positions, and which is which."""
