"""The moving hub: what it is to the rest of the suite; its simulation, and the line to a real one, in rooms below."""
