"""What must be known of a measured frequency response: damaged channels, and outputs that do not follow the input."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.data.records import InputSignal, OutputSignal
from beam_ident.sensing.damage import damage_warnings
from beam_ident.sensing.quantisation import clipped_warnings, coarse_warnings

_LEVEL = 1e-3  # chance that an output that has nothing to do with the input is not named
_MIN_FREEDOM = 2.0


def with_doubts(
    record: FrequencyRecord,
    outputs: Sequence[OutputSignal],
    drive: InputSignal,
    changes: Sequence[str] = (),
) -> FrequencyRecord:
    """Return a response with warnings of what its samples and its lines show.

    Parameters
    ----------
    record : FrequencyRecord
    outputs : sequence of OutputSignal -- from which it was made
    drive : InputSignal
    changes : sequence of str
        What ``changing_warnings`` says; a damaged channel changes too, and is then named as what it is.
    """
    damage = (*clipped_warnings(outputs), *damage_warnings(outputs, [drive]), *_unrelated(record))
    said = (*(damage or changes), *coarse_warnings(outputs))
    return replace(record, warnings=(*record.warnings, *said)) if said else record


def _unrelated(record: FrequencyRecord) -> tuple[str, ...]:
    """Return which responses stand out of their noise at no line at all.

    Parameters
    ----------
    record : FrequencyRecord -- with variances; without, nothing is known

    Notes
    -----
    Without a relation ``|G|^2 / var G`` is F-distributed with 2 and 2 nu degrees of freedom, and beyond x with the
    chance ``(1 + x / nu)^-nu``; the largest over all lines is taken.
    """
    if record.variance is None:
        return ()
    said = []
    freedom = max(record.degrees_of_freedom - 1.0, _MIN_FREEDOM)
    for j, output in enumerate(record.output_names):
        for i, drive in enumerate(record.input_names):
            values, variance = np.abs(record.response[:, j, i]) ** 2, record.variance[:, j, i]
            known = np.isfinite(values) & np.isfinite(variance)
            if not np.any(known) or np.any(known & (variance <= 0.0)):
                continue
            highest = float(np.max(values[known] / variance[known]))
            rarity = -math.log(_LEVEL / np.count_nonzero(known))
            limit = rarity if math.isinf(freedom) else freedom * math.expm1(min(rarity / freedom, 700.0))
            if highest < limit:
                said.append(
                    f"the response of {output!r} to {drive!r} stands out of its noise at no line: it is no more than "
                    "chance. Is it the right input, on the same clock?"
                )
    return tuple(said)
