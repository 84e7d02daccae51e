"""Pixels to metres: scale, lens, boards and their files; a camera's noise."""
