"""What sensors do to values: rounding, clipping, and noise that an input shows at rest."""
