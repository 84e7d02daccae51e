"""The continuous beam: mode shapes, exact frequency responses, spectral elements."""
