"""What the model advises for an experiment, in numbers, words and figures."""
