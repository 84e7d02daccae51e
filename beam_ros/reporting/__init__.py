"""Reports of bags: what a laboratory signs, with provenance, theory, a film, and comparisons."""
