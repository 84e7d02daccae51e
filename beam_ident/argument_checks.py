"""What every estimator asks of its arguments before it begins."""

from __future__ import annotations

from typing import Any

import numpy as np

from beam_ident.errors import EstimationError
from beam_ident.piecewise import FloatArray
from beam_ident.records import InputSignal, TimeRecord

_SMALLEST = 1e-100  # size of a signal: squares of what is smaller, or larger than its inverse, are lost


def require_record(record: object) -> None:
    """Raise EstimationError for anything but one time record."""
    if not isinstance(record, TimeRecord):
        raise EstimationError(
            f"record is a {type(record).__name__}; expected one TimeRecord (identify() takes several in one fit)"
        )


def require_whole_number(name: str, value: Any, least: int, most: int | None = None) -> None:
    """Raise EstimationError for what is no whole number between two bounds, both included."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool | np.bool_)
    if not is_whole or value < least or (most is not None and value > most):
        bounds = f"at least {least}" if most is None else f"{least} to {most}"
        raise EstimationError(f"{name} is {value!r}; expected a whole number, {bounds}")


def require_size(what: str, values: FloatArray) -> None:
    """Raise EstimationError for values that are not zero and whose squares leave the range of numbers."""
    size = float(np.max(np.abs(values), initial=0.0))
    if size > 0.0 and not _SMALLEST < size < 1.0 / _SMALLEST:
        raise EstimationError(
            f"{what} reaches {size:.3g}, whose square is beyond what can be computed with; expected "
            f"{_SMALLEST:g} to {1.0 / _SMALLEST:g}. Check its unit, or its sensor"
        )


def require_output(name: str, values: FloatArray) -> None:
    """Raise EstimationError for an output that never changes, or of an absurd size.

    Parameters
    ----------
    name : str
    values : ndarray, shape (n,) -- the samples that can be used; whether they are enough is asked elsewhere
    """
    require_size(f"output {name!r}", values)
    if len(values) > 1 and np.ptp(values) == 0.0:
        raise EstimationError(
            f"output {name!r} is constant ({values[0] + 0.0:g}) over {len(values)} samples; nothing can be "
            "identified from it. Check the sensor, or leave this output out"
        )


def require_input(drive: InputSignal, is_needed: bool = True) -> None:
    """Raise EstimationError for an input of an absurd size, or one at zero throughout where it is needed."""
    require_size(f"input {drive.name!r}", drive.values)
    if is_needed and not np.any(drive.values):
        raise EstimationError(f"input {drive.name!r} is zero throughout; it excites nothing")


def require_moving_input(drive: InputSignal) -> None:
    """Raise EstimationError for an input whose constant value holds no frequency, or of an absurd size."""
    require_size(f"input {drive.name!r}", drive.values)
    if np.ptp(drive.values) == 0.0:
        raise EstimationError(
            f"input {drive.name!r} is constant ({drive.values[0] + 0.0:g}); it excites no frequency"
        )
