"""From the rig's excitation parameters to checked samples for its hub."""
