"""Verbs that judge bags, identify them, and compare what came of it."""
