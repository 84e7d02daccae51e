"""Tests, as packages: rooms may have test files of the same name."""
