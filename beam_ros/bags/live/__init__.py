"""Bags while a rig runs: a recording in progress, and a replay."""
