"""Missing samples of an input: bridged from both sides, and how well that is known.

A short hole in a sampled signal is determined by what stands around it: an autoregression is fitted to the samples
beside the hole, and the missing ones are those that its prediction errors, taken together, like best (A. Janssen,
R. Veldhuis, L. Vries, IEEE Trans. ASSP 34 (1986), 317-330).  Its lags are multiples of a stride, so that a
long hole in a finely sampled signal is seen on the signal's own scale.  What a bridge is worth
is not believed but measured: the same rule fills holes of the same length beside the true one, where the samples
are known.  The rule that does best there is taken, and its error there is the bridge's uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.errors import RecordError

POOR_BRIDGE = 0.01
"""Of an input's size: a bridge so uncertain is believed by nobody but a model that says what it does."""

_ORDERS = (12, 48)  # of the autoregression
_SAMPLES_PER_HOLE = 16  # at the stride of a long hole
_NEIGHBOURHOOD = 6  # holes' lengths to either side from which the autoregression comes
_MIN_NEIGHBOURHOOD = 8  # orders to either side
_TRIALS = 4  # holes of the same length, to either side
_NAMED = 5  # gaps in a sentence
_IRREGULAR = 0.01  # of a step: stamps that wander more take no autoregression
_RANK = 1e-11  # of the largest eigenvalue: sums of 10 000 products are rounded by 1e-12 of it, whatever the processor

_OFF_GRID = 0.1  # of a step: stamps that wander more are no grid from which samples could be missing
_STEADY, _STANDS_OUT = (
    0.02,
    8.0,
)  # of a period, and deviations of the steps: stamps off the grid by more are no rounding
_MOSTLY = 2.0 / 3.0  # of the steps: fewer that are one period long, or beside a hole, are no grid with holes

_Rule = Callable[[int, int], FloatArray]


@dataclass(frozen=True)
class InputGap:
    """A stretch in which samples of an input are missing.

    Attributes
    ----------
    start_s, end_s : float -- stamps of the last sample before and of the first one after it [s]
    missing : int -- samples that were filled in
    sigma : float -- standard deviation of what was filled in
    errors : ndarray, shape (n_trials, missing)
        What the same rule missed where the samples are known, evenly spread between start and end.
    """

    start_s: float
    end_s: float
    missing: int
    sigma: float
    errors: FloatArray = field(compare=False, repr=False)

    @property
    def middle_s(self) -> float:
        """Middle of the stretch [s]."""
        return 0.5 * (self.start_s + self.end_s)


def on_every_stamp(times_s: FloatArray, values: FloatArray, is_held: bool) -> tuple[FloatArray, FloatArray]:
    """Return an input with a stamp for every sample that its grid lacks, NaN where it has none.

    Parameters
    ----------
    times_s : ndarray, shape (n,) -- stamps [s]
    values : ndarray, shape (n,)
    is_held : bool -- whether the input stays what it is until the next sample: at zero it may do so for long

    Notes
    -----
    Stamps are a grid with holes where all steps are whole numbers of periods, most of them one, those beside
    holes too.  Stamps at which a value merely changes, or those of two rates one after the other, are not.
    """
    steps = np.diff(times_s)
    if len(steps) < 2 or not np.max(steps) > 1.5 * (usual := float(np.median(steps))):
        return times_s, values
    periods = np.rint(steps / usual)
    is_hole = periods > 1.0
    # Elsewhere between two samples a clock may have jumped instead.
    scatter = 1.4826 * float(np.median(np.abs(steps - usual)))
    off_grid = min(max(_STEADY * usual, _STANDS_OUT * scatter), _OFF_GRID * usual)
    beside = np.concatenate([is_hole[1:], [False]]) | np.concatenate([[False], is_hole[:-1]])
    if (
        np.max(np.abs(steps - periods * usual)) > off_grid
        or np.mean(~is_hole) < _MOSTLY
        or np.mean(~is_hole[beside]) < _MOSTLY * float(np.mean(~is_hole))
    ):
        return times_s, values
    if is_held:
        is_hole &= (values[:-1] != 0.0) | (values[1:] != 0.0)
    places = np.arange(len(times_s)) + np.concatenate([[0], np.cumsum(np.where(is_hole, periods - 1.0, 0.0))])
    every = np.arange(int(places[-1]) + 1)
    found = np.full(len(every), np.nan)
    found[places.astype(np.intp)] = values
    return np.asarray(np.interp(every, places, times_s)), found


def bridged(name: str, times_s: FloatArray, values: FloatArray) -> tuple[FloatArray, tuple[InputGap, ...]]:
    """Return an input with its missing samples filled in, and where that was.

    Parameters
    ----------
    name : str -- for messages
    times_s : ndarray, shape (n,) -- stamps, those of the missing samples too [s]
    values : ndarray, shape (n,) -- NaN where a sample is missing

    Raises
    ------
    RecordError
        Fewer than two samples, or the first or the last one is missing.
    """
    seen = np.isfinite(values)
    if np.count_nonzero(seen) < 2 or not (seen[0] and seen[-1]):
        raise RecordError(
            f"input {name!r}: {np.count_nonzero(seen)} of {len(values)} values are known, the first being "
            f"{values[0]} and the last {values[-1]}; expected an input that is known at both ends. "
            "Leave out what lies outside of the known samples"
        )
    found = np.array(values)
    gaps = []
    edges = np.flatnonzero(np.diff(seen))
    for before, last in zip(edges[::2], edges[1::2], strict=True):
        first, n = int(before) + 1, int(last - before)
        bridge = Bridge(times_s, values, first, n)
        found[first : first + n] = bridge.values
        gaps.append(bridge.gap)
    return found, tuple(gaps)


class Bridge:
    """One hole, filled by the rule that fills holes beside it best.

    Parameters
    ----------
    times_s : ndarray, shape (n_all,) -- stamps [s]
    values : ndarray, shape (n_all,) -- NaN where a sample is missing; those beside the hole are known
    first, n : int -- the first missing sample of the hole, and how many follow without one that is known
    """

    def __init__(self, times_s: FloatArray, values: FloatArray, first: int, n: int) -> None:
        reach = max(_NEIGHBOURHOOD * n, _MIN_NEIGHBOURHOOD * _ORDERS[-1])
        low, high = max(first - reach, 0), min(first + n + reach, len(values))
        self._times, self._seen = times_s[low:high], np.isfinite(values[low:high])
        known = values[low:high][self._seen]
        steps = np.diff(self._times)
        self._mean, self._spread = float(np.mean(known)), float(np.std(known))
        self._values = np.where(self._seen, values[low:high] - self._mean, 0.0)
        self._sight = first - low, high - (first + n)  # samples to either side; no trial sees more
        rules: list[_Rule] = [self._straight]
        if np.ptp(steps) < _IRREGULAR * np.mean(steps):
            stride = max(1, n // _SAMPLES_PER_HOLE)
            rules += [rule for order in _ORDERS if (rule := self._autoregression(order, stride)) is not None]
        trials = self._trials(first - low, n)
        errors = [self._errors(rule, trials, n) for rule in rules]
        best = int(np.argmin([np.mean(np.square(missed)) for missed in errors]))
        self.values = rules[best](first - low, n) + self._mean
        sigma = float(np.sqrt(np.mean(np.square(errors[best]))))
        self.gap = InputGap(float(times_s[first - 1]), float(times_s[first + n]), n, sigma, errors[best])

    def _trials(self, first: int, n: int) -> list[int]:
        """Return where holes of this length could be whose samples and neighbours are known."""
        places = [first + side * (n + max(n // 2, 2)) * k for k in range(1, _TRIALS + 1) for side in (-1, 1)]
        return [
            place
            for place in places
            if place > 0 and np.all(self._seen[place - 1 : place + n + 1]) and place + n < len(self._seen)
        ]

    def _errors(self, rule: _Rule, trials: list[int], n: int) -> FloatArray:
        """Return what a rule misses at known places; without any, all of the signal."""
        if not trials:
            return np.full((1, n), self._spread)
        return np.stack([rule(place, n) - self._values[place : place + n] for place in trials])

    def _straight(self, first: int, n: int) -> FloatArray:
        """Fill a hole by a straight line."""
        ends = [first - 1, first + n]
        return np.asarray(np.interp(self._times[first : first + n], self._times[ends], self._values[ends]))

    def _autoregression(self, order: int, stride: int) -> _Rule | None:
        """Return the rule of an autoregression with lags of a stride; None where too few samples are known."""
        span = order * stride + 1
        if len(self._values) < 2 * span:
            return None
        whole = np.all(sliding_window_view(self._seen, span)[:, ::stride], axis=1)
        if np.count_nonzero(whole) < 2 * order:
            return None
        rows = sliding_window_view(self._values, span)[whole][:, ::stride]
        # Backwards a stationary signal has the same autoregression.
        rows = np.concatenate([rows, rows[:, ::-1]])
        from scipy.linalg import pinvh  # here: records are made where nothing is missing

        gram = rows.T @ rows
        found = pinvh(gram[:-1, :-1], rtol=_RANK) @ gram[:-1, -1]
        coefficients = np.append(-found, 1.0)

        def fill(first: int, n: int) -> FloatArray:
            result = np.empty(n)
            for phase in range(min(stride, n)):
                places = np.arange(first + phase, first + n, stride)
                line = self._line(first, n, phase, order, stride)
                result[phase::stride] = self._most_likely(coefficients, places, line)
            return result

        return fill

    def _line(self, first: int, n: int, phase: int, order: int, stride: int) -> IndexArray:
        """Return every stride-th sample in a hole and beside it, as far as is seen from the true hole."""
        left, right = self._sight
        start = first + phase
        low = max(first - left, 0)
        high = min(first + n + right, first + n + stride * order, len(self._values))
        return np.arange(start - stride * min(order, (start - low) // stride), high, stride)

    def _most_likely(self, coefficients: FloatArray, places: IndexArray, line: IndexArray) -> FloatArray:
        """Return the samples at some places of a line that make the squared prediction errors along it least."""
        order, n = len(coefficients) - 1, len(line)
        unknown = ~self._seen[line] | np.isin(line, places)
        errors = np.zeros((max(n - order, 0), n))
        for row in range(len(errors)):
            errors[row, row : row + order + 1] = coefficients
        known = np.where(unknown, 0.0, self._values[line])
        from scipy.linalg import lstsq

        found = lstsq(errors[:, unknown], -errors @ known, cond=_RANK, lapack_driver="gelsy")[0]
        return np.asarray(found[np.isin(line[unknown], places)])


def describe_gaps(
    name: str,
    gaps: Sequence[InputGap],
    unit: str,
    anew: Sequence[InputGap] = (),
    rigid: Collection[InputGap] = (),
) -> str:
    """Return one sentence on the gaps of an input and what was done about them; nothing where there are none.

    Parameters
    ----------
    name, unit : str -- of the input
    gaps : sequence of InputGap
    anew : sequence of InputGap -- those of them after which the motion begins anew
    rigid : collection of InputGap -- those after which only the constants of the input's integration do
    """
    if not gaps:
        return ""
    places = ", ".join(f"{gap.start_s:.3f}-{gap.end_s:.3f} s" for gap in gaps[:_NAMED])
    more = f" and {len(gaps) - _NAMED} more" if len(gaps) > _NAMED else ""
    worst = max(gap.sigma for gap in gaps)
    said = (
        f"Input {name} has {len(gaps)} gap{'s' if len(gaps) > 1 else ''} ({places}{more}): "
        f"{sum(gap.missing for gap in gaps)} samples were filled in from both sides, the worst gap "
        f"to {worst:.2g} {unit}"
    )
    if anew:
        said += (
            f"; after {len(anew)} of them the motion begins anew, since that is not sure enough, and a mode that the "
            "input moved there alone may be missed"
        )
    if rigid:
        said += f"; after {len(rigid)} of them the constants of the input's integration begin anew"
    return f"{said}."
