"""Curves of frequency and damping over amplitude, for what a single pole cannot say."""
