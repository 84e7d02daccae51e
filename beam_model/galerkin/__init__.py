"""The Galerkin model: matrices, exact stepping, frequency responses, linear forms."""
