"""Experiments as plans: recordings, estimations and validations in one file, and the folder they end in."""
