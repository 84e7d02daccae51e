"""Values of a plan with their units, as ``20 s`` or ``5 mm``; a bare number is in SI, as in a rig file."""

from __future__ import annotations

import re
from collections.abc import Mapping

from beam_ros.errors import ParameterFileError, suggestion
from beam_ros.interfaces.parameter import Parameter

_LENGTHS: Mapping[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
UNITS: dict[str, Mapping[str, float]] = {
    "m": _LENGTHS,
    "m/s": {f"{name}/s": factor for name, factor in _LENGTHS.items()},
    "m/s^2": {f"{name}/s^2": factor for name, factor in _LENGTHS.items()},
    "m/s^3": {f"{name}/s^3": factor for name, factor in _LENGTHS.items()},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "kg": {"kg": 1.0, "g": 1e-3},
    "N": {"N": 1.0, "mN": 1e-3},
    "1": {"%": 1e-2},
}
"""Units that a value may be given in, and their factor to the SI unit of the parameter."""

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\s\d].*?)?\s*")


def in_si(parameter: Parameter, value: object) -> object:
    """Return the value of a plan as the parameter takes it: a number with its unit becomes one in SI.

    Parameters
    ----------
    parameter : Parameter -- of the rig's table; its kind and its unit say what is expected
    value : object -- as YAML gave it

    Returns
    -------
    object -- floats for quantities; everything else as it was given, for the table to check

    Raises
    ------
    ParameterFileError
        A number with a unit that the parameter is not in.

    Examples
    --------
    ``20 s`` for ``excitation.duration`` is 20.0; ``20 mm`` is refused.
    """
    if parameter.kind == tuple[float, ...] and isinstance(value, (list, tuple)):
        return [_scalar(parameter, item) for item in value]
    return _scalar(parameter, value) if parameter.kind is float else value


def _scalar(parameter: Parameter, value: object) -> object:
    if not isinstance(value, str):
        return value
    match = _QUANTITY.fullmatch(value)
    if match is None:
        return value
    known = UNITS.get(parameter.unit, {parameter.unit: 1.0} if parameter.unit else {})
    unit = match[2] or ""
    if not unit:
        return float(match[1])
    if unit not in known:
        expected = suggestion(unit, known) if known else "it has no unit"
        raise ParameterFileError(
            f"{parameter.name} is {value!r}, and {unit!r} is not a unit of {parameter.description}: {expected}; give "
            f"{parameter.expectation()}"
        )
    return float(match[1]) * known[unit]
