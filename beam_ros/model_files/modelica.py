"""A model as Modelica text: states, with inputs and outputs that connect to the blocks of its standard library."""

from __future__ import annotations

import re

from beam_ros.arrays import FloatArray
from beam_ros.errors import UsageError
from beam_ros.model_files.formats import WriteRequest

_MODELICA_UNITS = {"m/s2": "m/s2", "m/s": "m/s", "m": "m", "N": "N"}


def modelica_file(request: WriteRequest) -> bytes:
    """Return the text.

    Raises
    ------
    UsageError
        The file's name is no name of Modelica, or the model has a delay.
    """
    model, name = request.model, request.target.stem
    if not re.fullmatch(r"[A-Za-z_]\w*", name):
        raise UsageError(
            f"--modelica {request.target}: {name!r} is no name of a model; expected letters and digits"
        )
    require_no_delay(request, "--modelica")
    signals = [
        *(f"  // u[{k}]: {own}{_in(model.input_unit)}" for k, own in enumerate(model.input_names, 1)),
        *(f"  // y[{j}]: {own}{_in(model.output_unit)}" for j, own in enumerate(model.output_names, 1)),
    ]
    lines = [
        f'model {name} "{model.source}"',
        *signals,
        f"  Modelica.Blocks.Interfaces.RealInput u[{len(model.input_names)}]{_unit(model.input_unit)};",
        f"  Modelica.Blocks.Interfaces.RealOutput y[{len(model.output_names)}]{_unit(model.output_unit)};",
        f"  Real x[{len(model.transition)}](each start = 0.0, each fixed = true);",
        "protected",
        *(
            f"  parameter Real {letter}[{matrix.shape[0]}, {matrix.shape[1]}] = {_written(matrix)};"
            for letter, matrix in (
                ("A", model.transition),
                ("B", model.entry),
                ("C", model.rows),
                ("D", model.through),
            )
        ),
        "equation",
        "  der(x) = A * x + B * u;",
        "  y = C * x + D * u;",
        f"end {name};",
    ]
    return ("\n".join(lines) + "\n").encode()


def require_no_delay(request: WriteRequest, flag: str) -> None:
    """Raise UsageError for a model with a delay, which states without memory of the input do not have."""
    delays = request.model.delays
    if delays.any():
        raise UsageError(
            f"{flag}: the model has a delay of {float(delays.max()):.6g} s, which states do not have; write "
            "--mat, which keeps it, or identify with --delay 0 where the sensor is what is late"
        )


def _in(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _unit(unit: str) -> str:
    return f'(each unit = "{_MODELICA_UNITS[unit]}")' if unit in _MODELICA_UNITS else ""


def _written(matrix: FloatArray) -> str:
    return "{" + ", ".join("{" + ", ".join(map(repr, row)) + "}" for row in matrix.tolist()) + "}"
