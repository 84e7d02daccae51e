"""Synthetic frames of the rig."""
