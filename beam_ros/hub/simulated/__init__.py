"""The axis that is not there: states, plant and clock of a simulated hub."""
