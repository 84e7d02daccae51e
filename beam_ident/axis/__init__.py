"""A driven axis: its mass, friction, constant force and delay from force and position."""
