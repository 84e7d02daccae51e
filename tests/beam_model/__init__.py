"""Tests of the beam model: physics against closed forms."""
