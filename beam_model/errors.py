"""Errors of the beam model: each says what was wrong, the value seen, what was expected and what to do."""

from __future__ import annotations


class BeamModelError(Exception):
    """Base of every error that this package raises on purpose."""


class BeamParameterError(BeamModelError, ValueError):
    """A parameter or argument lies outside of its range.

    Attributes
    ----------
    name : str
        The parameter.
    value : object
        What was given.
    unit : str
        Its unit ("" for a pure number).
    """

    def __init__(self, name: str, value: object, unit: str, expected: str, remedy: str = "") -> None:
        self.name = name
        self.value = value
        self.unit = unit
        shown = f"{value!r} {unit}".rstrip()
        text = f"{name} = {shown} is out of range: expected {expected}"
        super().__init__(f"{text}. {remedy}" if remedy else text)


class PhysicalFitError(BeamModelError, ValueError):
    """The data given cannot determine the physical parameters that were asked for."""
