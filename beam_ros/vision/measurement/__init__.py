"""From frames to displacements: the measuring chain, its continuity and its diagnosis."""
