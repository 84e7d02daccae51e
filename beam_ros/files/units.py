"""Units in the headings of columns: which SI unit one means, and what an input or an output in it is.

``tip [mm]``, ``tip (mm)``, ``tip / mm`` and ``tip_mm`` are one name with one unit.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

STANDARD_GRAVITY = 9.80665  # m/s^2, by definition


@dataclass(frozen=True)
class Unit:
    """What a unit is worth.

    Attributes
    ----------
    si : str -- the SI unit of its quantity
    factor : float -- of that in one of it
    """

    si: str
    factor: float = 1.0


_MULTIPLES = {"n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "": 1.0}


def _scaled(symbol: str, prefixes: str, si: str | None = None) -> dict[str, Unit]:
    """Return a unit and its multiples; ``symbol`` has {} where the prefix goes."""
    plain = symbol.format("")
    return {symbol.format(prefix): Unit(si or plain, _MULTIPLES[prefix]) for prefix in ("", *prefixes)}


_UNITS: dict[str, Unit] = {
    **_scaled("{}s", "num"),
    "min": Unit("s", 60.0),
    **_scaled("{}m", "numck"),
    **_scaled("{}m/s", "numc"),
    **_scaled("{}m/s^2", "umc"),
    "in": Unit("m", 0.0254),
    "g": Unit("m/s^2", STANDARD_GRAVITY),
    "mg": Unit("m/s^2", 1e-3 * STANDARD_GRAVITY),
    "rad": Unit("rad"),
    "deg": Unit("rad", math.pi / 180.0),
    "rad/s": Unit("rad/s"),
    "deg/s": Unit("rad/s", math.pi / 180.0),
    "rad/s^2": Unit("rad/s^2"),
    **_scaled("{}N", "umk"),
    **_scaled("{}N m", "umk"),
    **_scaled("{}V", "umk"),
    **_scaled("{}A", "um"),
}
_SPELLINGS = {
    "µ": "u",
    "μ": "u",
    "²": "^2",
    "**2": "^2",
    "/s/s": "/s^2",
    "/s2": "/s^2",
    "_s2": "/s^2",
    "_s": "/s",
    "°": "deg",
    "Nm": "N m",
    "N*m": "N m",
    "N·m": "N m",
    "inch": "in",
    "sec": "s",
    "seconds": "s",
}

INPUT_KINDS = {
    "m": "position",
    "rad": "position",
    "m/s": "velocity",
    "rad/s": "velocity",
    "m/s^2": "acceleration",
    "rad/s^2": "acceleration",
    **dict.fromkeys(("N", "N m", "V", "A"), "force"),
}
"""What an input in an SI unit is; a voltage or a current is what makes a force."""

OUTPUT_KINDS = {
    "m": "receptance",
    "rad": "receptance",
    "m/s": "mobility",
    "rad/s": "mobility",
    "m/s^2": "accelerance",
    "rad/s^2": "accelerance",
}
"""What an output in an SI unit is: a sensor of displacement, velocity or acceleration."""

_ALSO_WORDS = ("min", "in")
"""Behind a ``_`` these are no units: ``x_min``, ``u_in``."""

_BRACKETS = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))\s*$")
_SLASH = re.compile(r"^(?P<name>\S+)(?:\s+/\s*|/)(?P<unit>\S+)$")


def find_unit(text: str) -> Unit | None:
    """Return what a unit is worth, None where it is not known."""
    symbol = text.strip()
    for spelling, meant in _SPELLINGS.items():
        if symbol not in _UNITS:
            symbol = symbol.replace(spelling, meant)
    return _UNITS.get(symbol)


def known_units() -> str:
    """Return all units in one line for people."""
    return ", ".join(_UNITS)


def split_heading(heading: str) -> tuple[str, str]:
    """Return the name and the unit of a column's heading; the unit is empty where there is none.

    What stands in brackets is taken for a unit also where it is not known; behind ``/`` or ``_`` it is one only
    where it is known.
    """
    text = heading.strip()
    if found := _BRACKETS.match(text):
        unit = found["square"] if found["square"] is not None else found["round"]
        return found["name"].strip() or text, unit.strip()
    if (found := _SLASH.match(text)) and find_unit(found["unit"]):
        return found["name"], found["unit"]
    words = text.split("_")
    for first in range(1, len(words)):
        unit = "_".join(words[first:])
        if unit not in _ALSO_WORDS and find_unit(unit):
            return "_".join(words[:first]), unit
    return text, ""
