"""Pixels to metres: scale, lens, boards and their files."""
