"""Whether a model is to be trusted: hold-out validation, comparisons, repeatability."""
