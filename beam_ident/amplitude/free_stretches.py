"""Where a record rings freely: after its input has come to rest for good."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beam_ident.data.records import OutputSignal, TimeRecord
from beam_ident.errors import EstimationError

_STILL = 6.0  # standard deviations of the noise on the input
_ROUNDING = 1e-9  # of what the input has moved
_OF_BENDS = 0.6745 * 6.0**0.5  # median size of white noise's second differences, in its standard deviations
_GUARD_S = 0.1  # longer than any sensor's own delay
_GUARD_SHARE = 0.05  # of what rings freely, where that is short


def free_decay_of(record: TimeRecord) -> list[OutputSignal]:
    """Return the outputs after the input's last motion.

    Parameters
    ----------
    record : TimeRecord
        With inputs that come to rest; their ``sigma`` says how much noise is no motion. Where it is not given, the
        scatter from sample to sample in the last tenth is.

    Raises
    ------
    EstimationError
        An input moves until the end.
    """
    begin = -np.inf
    for drive in record.inputs:
        values, times = drive.values, drive.times_s
        last = slice(len(values) - max(len(values) // 10, 2), None)
        bends = np.diff(values[last], 2)
        scatter = float(np.median(np.abs(bends))) / _OF_BENDS if bends.size else 0.0
        quiet = _STILL * max(drive.sigma, scatter) + _ROUNDING * float(np.ptp(values))
        moved = np.flatnonzero(np.abs(values - np.median(values[last])) > quiet)
        if moved.size:
            begin = max(begin, float(times[min(int(moved[-1]) + 1, len(times) - 1)]))
    end = min(drive.span_s[1] for drive in record.inputs)
    kept = []
    for output in record.outputs:
        guard = min(_GUARD_S, _GUARD_SHARE * (end - begin))
        inside = (output.times_s > begin + guard) & (output.times_s < end)
        if np.count_nonzero(inside & output.is_valid) < 2:
            raise EstimationError(
                f"record {record.name!r}: the input moves until {begin:.3f} s and {output.name!r} was seen until "
                f"{float(output.times_s[-1]):.3f} s, so that nothing rings freely; expected a still input at the "
                "end: record on for at least twenty cycles after the excitation"
            )
        kept.append(replace(output, times_s=output.times_s[inside], values=output.values[inside]))
    return kept
