"""Beyond the linear beam: air drag and large deflections, friction, servo and stops of the axis."""
