"""Modal models from records of time: the call, its searches, the clocks of signals, and the result."""
