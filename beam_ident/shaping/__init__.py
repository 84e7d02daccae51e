"""Moves that leave the beam at rest: shaped commands, what swing they leave, and the choice among them."""
