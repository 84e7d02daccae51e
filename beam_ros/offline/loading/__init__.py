"""From a bag to the records that a model is fitted to."""
