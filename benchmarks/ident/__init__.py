"""Seeded studies of the identification, in units of the Cramer-Rao bound."""
