"""Tests of the set-up, of both ways to build the package and of what they promise."""
