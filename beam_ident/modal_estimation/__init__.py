"""Fits of modes, their search, and what identifies frequency records and free decays."""
