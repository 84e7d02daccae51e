"""A motion controller's firmware, emulated on a pseudo-terminal."""
