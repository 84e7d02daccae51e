"""What the rows of a study say together of every mode: scatter against stated deviations, and against theory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.studies.rows import Row

_OF_95_PERCENT = 1.959964
QUANTITIES = {
    "frequency": ("frequency_hz", "frequency_sd_hz"),
    "damping": ("damping_ratio", "damping_ratio_sd"),
}


@dataclass(frozen=True)
class ModeStatistics:
    """A natural frequency or a damping ratio over all rows that have it.

    Attributes
    ----------
    mode : int -- of theory, from 1
    quantity : str -- "frequency" [Hz] or "damping"
    count : int -- rows
    median : float
    scatter : float -- standard deviation over the rows
    stated_sd : float -- median of the stated standard deviations
    largest_error : float -- from the theory of each row, relative
    judged : int -- rows with a theory
    covered : int -- of these, those whose 95 % interval holds the theory's value
    """

    mode: int
    quantity: str
    count: int
    median: float
    scatter: float
    stated_sd: float
    largest_error: float
    judged: int
    covered: int

    @property
    def coverage(self) -> float:
        """Share of the judged rows whose 95 % interval holds the theory's value; NaN where there are none."""
        return self.covered / self.judged if self.judged else math.nan

    @property
    def coverage_range(self) -> tuple[float, float]:
        """Where that share would lie in endlessly many rows, with 95 % confidence (Wilson's interval)."""
        if not self.judged:
            return 0.0, 1.0
        n, p, z = self.judged, self.coverage, _OF_95_PERCENT
        middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
        half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
        return max(0.0, middle - half), min(1.0, middle + half)

    def to_dict(self) -> dict[str, Any]:
        """Return it in plain values."""
        return {**asdict(self), "coverage": self.coverage, "coverage_range": self.coverage_range}


def mode_statistics(rows: Sequence[Row]) -> tuple[ModeStatistics, ...]:
    """Return the statistics of all modes that any row has, in the order of theory."""
    modes = {int(name[4 : name.index("_")]) for row in rows for name in row if name.startswith("mode")}
    found = (_statistics(rows, mode, quantity) for mode in sorted(modes) for quantity in QUANTITIES)
    return tuple(own for own in found if own is not None)


def rows_by_beam(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows by the beam that their bags describe: modes of different beams say nothing together.

    Returns
    -------
    dict -- by a name for a reader, the largest group first; rows without modes are in none
    """
    groups: dict[str, list[Row]] = {}
    for row in rows:
        if any(name.startswith("mode") for name in row):
            groups.setdefault(row.get("beam") or "", []).append(row)
    ordered = sorted(groups.items(), key=lambda group: -len(group[1]))
    letters = (f"beam {number}" for number in range(1, len(ordered) + 1))
    return {
        (f"{name} ({len(own)} rows)" if beam else f"bags that describe no beam ({len(own)} rows)"): own
        for name, (beam, own) in zip(letters, ordered, strict=True)
    }


def values_of(rows: Sequence[Row], mode: int, quantity: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a mode's values, standard deviations and those of theory (NaN: none), of the rows that have it."""
    value, sd = (f"mode{mode}_{name}" for name in QUANTITIES[quantity])
    theory = f"mode{mode}_theory_{QUANTITIES[quantity][0]}"
    table = [(row[value], row[sd], row.get(theory)) for row in rows if row.get(value) and row.get(sd)]
    values, sds, theories = np.array(table, dtype=np.float64).reshape(-1, 3).T
    return values, sds, theories


def _statistics(rows: Sequence[Row], mode: int, quantity: str) -> ModeStatistics | None:
    values, sds, theory = values_of(rows, mode, quantity)
    if not len(values):
        return None
    errors = np.abs(values / theory - 1.0)[np.isfinite(theory)]
    return ModeStatistics(
        mode=mode,
        quantity=quantity,
        count=len(values),
        median=float(np.median(values)),
        scatter=float(np.std(values, ddof=1)) if len(values) > 1 else math.nan,
        stated_sd=float(np.median(sds)),
        largest_error=float(np.max(errors)) if len(errors) else math.nan,
        judged=len(errors),
        covered=int(np.count_nonzero(np.abs(values - theory) <= _OF_95_PERCENT * sds)),
    )
