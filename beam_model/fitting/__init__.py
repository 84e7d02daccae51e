"""Physical parameters from measured modes, and theory against measurement."""
