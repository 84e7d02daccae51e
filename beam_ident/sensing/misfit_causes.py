"""What the residuals of a fit look like: the likeliest cause of a misfit, named with its size and its instant.

Residuals that are not noise say more than that.  Stamps that are late leave a multiple of the model's own slope, a
wrong clock the slope times time, a sensor that came loose the model itself from some instant on.  Each cause is a
few columns; it is named where these columns explain more of the residuals than noise of the residuals' colour would.

How often it is wrong: ``_LEVEL`` for each of nine kinds, divided by the instants or frequencies at which a kind was
looked for, is one output in a thousand.  Of 1600 records of 1000 samples under white noise, a moving average, AR(0.9)
and a wide resonance, two were given a cause.  Noise as slow as a tenth of the record is said to drift (13 % of
AR(0.99)), and a resonance as sharp as a line to be one (2 %).  A column that the model could explain by other
parameters makes the test careful, never bold: residuals are at right angles to those parts.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.signal import lfilter
from scipy.special import chdtrc as chi_squared_sf

from beam_ident.arrays import FloatArray
from beam_ident.data.records import InputSignal
from beam_ident.noise.autoregression import autoregression
from beam_ident.noise.outliers import outliers
from beam_ident.noise.scores import ScoreTest, are_rounding
from beam_ident.numerics.linear_least_squares import LinearSolution

Part = tuple[FloatArray, FloatArray, FloatArray]  # times [s], modelled, residuals of one record

_LEVEL = 1e-4  # chance of a false alarm for each kind of cause
_LIKE_COLOUR = ("line", "jump", "drift")  # which an autoregression would take for its own
_CAREFUL = 100.0  # times rarer these must be: the colour without them is one that they chose
_MIN_SAMPLES = 60
_MOST_CAUSES = 3
_MARGIN = 0.05  # of the record, at either end: a change there cannot be told from an end of the motion
_AROUND = 16  # lines on either side that say how loud the noise beside a line is
_BESIDE = 3  # of them next to the line, which belong to it
_FINER = 8  # steps between two lines
_BEFORE, _AFTER = 8, 3  # samples of an input around a stamp
_MAINS_HZ = (50.0, 60.0)
_NOTHING = 1e-10  # of a column's square: what remains of it then is rounding


@dataclass(frozen=True, eq=False)
class _Cause:
    """A kind of cause, its columns where it explains most, and how it is said."""

    kind: str
    columns: FloatArray  # (n, k)
    beside: FloatArray  # (n, m), what other values of the fit's own parameters may leave
    looks: float  # at how many places it was looked for, and how much more careful that has to be
    said: Callable[[FloatArray], str]  # of the coefficients


def misfit_warnings(outputs: Sequence[tuple[str, Sequence[Part]]]) -> list[str]:
    """Return what the residuals of outputs look like, one sentence for each output that has more than noise.

    Parameters
    ----------
    outputs : sequence of (name, records)
        Of every output, record by record: stamps [s], what the model says there and what it leaves, each (n,).
    """
    warnings = []
    for name, parts in outputs:
        found = dict.fromkeys(said for part in parts for said in _causes(*part))
        if found:
            warnings.append(
                f"Misfit of {name}: the residuals look {'; and '.join(found)}. If that is so, poles are biased."
            )
    return warnings


def _causes(times: FloatArray, modelled: FloatArray, residuals: FloatArray) -> list[str]:
    """Return the causes in one record, the one that explains most first."""
    n, size = len(times), float(np.std(modelled))
    if n < _MIN_SAMPLES or not size > 0.0 or are_rounding(modelled + residuals, residuals):
        return []
    left = residuals.copy()
    left[outliers(left)] = 0.0  # they are named by themselves
    model = (modelled - np.mean(modelled)) / size
    slope = np.gradient(model, times)
    found: list[str] = []
    kinds: set[str] = set()
    for _ in range(_MOST_CAUSES):
        whitened = _Whitened.of(left)
        causes = [c for c in _candidates(times, model, slope, left, whitened, size) if c.kind not in kinds]
        # White residuals have no colour that could have taken up a line or a step.
        apart = [c for c in causes if len(whitened.colour) > 1 and c.kind in _LIKE_COLOUR]
        together = [c for c in causes if c not in apart]
        gains = list(zip(together, whitened.gains(together), strict=True))
        gains += [(cause, _without(cause, left).gains([cause])[0]) for cause in apart]
        best, best_gain = None, 0.0
        for cause, gain in gains:
            if gain > best_gain and _stands_without_weights(cause, left, modelled):
                best, best_gain = cause, gain
        if best is None:
            break
        kinds.add(best.kind)
        columns = np.column_stack([best.columns, best.beside])
        coefficients = LinearSolution.of(columns).coefficients(left)
        found.append(best.said(coefficients))
        left = left - columns @ coefficients
    return found


def _without(cause: _Cause, left: FloatArray) -> _Whitened:
    """Return residuals whitened by the colour that they have without a cause.

    A line or a step is itself the limit of a colour, an autoregression with a pole on the unit circle, which would
    leave nothing of it.
    """
    size = np.linalg.norm(cause.columns, axis=0)
    basis = LinearSolution.of(cause.columns / np.where(size > 0.0, size, 1.0)).basis
    return _Whitened.of(left, left - basis @ (basis.T @ left))


def _stands_without_weights(cause: _Cause, left: FloatArray, values: FloatArray) -> bool:
    """Return whether a cause that a fit could take up itself stands out of residuals without weights as well.

    A fit that does not weigh by the colour of its noise errs by more than one that does, and along these columns.
    """
    if cause.kind not in ("late", "exposure"):
        return True
    return ScoreTest.of([(cause.columns, cause.beside, left, values)]).p_value < _LEVEL


@dataclass(frozen=True)
class _Whitened:
    """Residuals as their autoregression leaves them.

    With the colour of the residuals with everything in them, what columns explain beyond it is the score of a
    Lagrange multiplier test, whose level holds for noise of any stationary colour.
    """

    colour: FloatArray
    left: FloatArray

    @staticmethod
    def of(left: FloatArray, noise: FloatArray | None = None) -> _Whitened:
        """Whiten residuals by the colour of their own, or of what is known to be noise."""
        colour = autoregression(left if noise is None else noise)
        return _Whitened(colour, lfilter(colour, [1.0], left)[len(colour) - 1 :])

    def columns(self, columns: FloatArray) -> FloatArray:
        """Whiten columns, shape (n, k)."""
        if len(self.colour) == 1:
            return columns
        rows = np.ascontiguousarray(columns.T)  # filters go along contiguous samples much faster
        return np.asarray(lfilter(self.colour, [1.0], rows)[:, len(self.colour) - 1 :].T)

    def gains(self, causes: Sequence[_Cause]) -> list[float]:
        """Return each cause's gain in log-likelihood less what it costs, 0 where noise would gain as much."""
        parts = list({id(part): part for cause in causes for part in (cause.columns, cause.beside)}.values())
        ends = np.cumsum([part.shape[1] for part in parts])
        places = {
            id(part): np.arange(end - part.shape[1], end) for part, end in zip(parts, ends, strict=True)
        }
        white = self.columns(np.concatenate(parts, axis=1))
        size = np.linalg.norm(white, axis=0)
        white = white / np.where(size > 0.0, size, 1.0)
        squares, products, power = white.T @ white, white.T @ self.left, float(self.left @ self.left)
        found = []
        for cause in causes:
            own, beside = places[id(cause.columns)], places[id(cause.beside)]
            # At right angles to what the fit's own parameters may leave.
            known = np.linalg.pinv(squares[np.ix_(beside, beside)], rcond=_NOTHING, hermitian=True)
            share = squares[np.ix_(own, beside)] @ known
            scores = products[own] - share @ products[beside]
            inner = squares[np.ix_(own, own)] - share @ squares[np.ix_(beside, own)]
            left = power - float(products[beside] @ known @ products[beside])
            found.append(self._gain(inner, scores, left, cause.looks))
        return found

    def _gain(self, inner: FloatArray, scores: FloatArray, power: float, looks: float) -> float:
        """Return what columns of some inner products gain that have ``scores`` with residuals of some power."""
        levels, vectors = np.linalg.eigh(inner)
        is_seen = levels > _NOTHING
        n, k = len(self.left), int(np.count_nonzero(is_seen))
        if not k or not power > 0.0:
            return 0.0
        explained = float(np.sum(np.square(vectors.T @ scores)[is_seen] / levels[is_seen]))
        left_over = max(power - explained, 1e-12 * power)
        if chi_squared_sf(k, (n - k) * (1.0 - left_over / power)) > _LEVEL / looks:
            return 0.0
        return float(0.5 * n * math.log(power / left_over) - 0.5 * k * math.log(n) - math.log(looks))


def _candidates(
    times: FloatArray,
    model: FloatArray,
    slope: FloatArray,
    left: FloatArray,
    whitened: _Whitened,
    size: float,
) -> list[_Cause]:
    """Return every kind of cause, with its columns at the instant or the frequency where it explains most."""
    middle = 0.5 * float(times[0] + times[-1])
    share = (times - middle) / (0.5 * float(times[-1] - times[0]))
    curvature = np.gradient(slope, times)
    own = np.column_stack([model, slope])
    causes = [
        _Cause(
            "late",
            slope[:, None],
            model[:, None],
            1.0,
            lambda c: (
                f"as if its stamps were {-1e3 * c[0] / size:.3g} ms late (its delay or latency, the input's hold or "
                "the clocks are not as stated)"
            ),
        ),
        _Cause(
            "clock",
            ((times - middle) * slope)[:, None],
            own,
            1.0,
            lambda c: f"as if its clock ran {-100.0 * c[0] / size:+.2g} % fast",
        ),
        _Cause(
            "exposure",
            curvature[:, None],
            own,
            1.0,
            lambda c: (
                "as if its exposure, or the input's hold, were not as stated: too "
                f"{'long' if c[0] < 0.0 else 'short'}, by {1e3 * math.sqrt(24.0 * abs(c[0]) / size):.2g} ms in "
                "the square"
            ),
        ),
        _Cause(
            "nonlinear",
            np.column_stack([model * np.abs(model), np.square(model), model**3]),
            own,
            1.0,
            lambda c: (
                "nonlinear: they follow squares and cubes of the output (dead band, saturation, bent scale)"
            ),
        ),
        _Cause(
            "drift",
            np.column_stack([np.ones_like(share), share, share**2, share**3]),
            own,
            _CAREFUL,
            lambda c: (
                "like an offset or a drift that the model does not have (has_offset, has_ramp), or slow noise"
            ),
        ),
    ]
    changes: list[tuple[str, FloatArray, Callable[..., str]]] = [
        ("gain", model, lambda c, at: (
            f"as if its gain changed by {c[0] / size:+.0%} at {at:.4g} s (a loose sensor, a channel dead or swapped)"
        )),
        ("jump", np.ones_like(model), lambda c, at: f"as if its offset jumped by {c[0]:+.3g} at {at:.4g} s"),
        ("clock jump", slope, lambda c, at: (
            f"as if its stamps were {-1e3 * c[0] / size:.3g} ms late from {at:.4g} s on (a clock that jumped)"
        )),
    ]  # fmt: skip
    for kind, column, said in changes:
        white = whitened.columns(column[:, None])[:, 0]
        place = (
            _change(column, left)
            if kind in _LIKE_COLOUR
            else len(column) - len(white) + _change(white, whitened.left)
        )
        at = float(times[place])
        after = np.where(np.arange(len(times)) >= place, column, 0.0)
        beside = np.column_stack([own, column])
        looks = len(times) * (_CAREFUL if kind in _LIKE_COLOUR else 1.0)
        causes.append(_Cause(kind, after[:, None], beside, looks, functools.partial(said, at=at)))
    line = _line(times, left, own)
    if line is not None:
        causes.append(line)
    return causes


def _change(column: FloatArray, left: FloatArray) -> int:
    """Return the sample from which on a column, freed of its whole, explains most of what is left."""
    n = len(column)
    total, power = float(column @ left), float(column @ column)
    product = np.cumsum((column * left)[::-1])[::-1]
    squares = np.cumsum(np.square(column)[::-1])[::-1]
    # The column from an instant on, at right angles to the whole column.
    inner = squares * (1.0 - squares / power)
    gain = np.square(product - squares / power * total) / np.maximum(inner, _NOTHING * power)
    margin = max(int(_MARGIN * n), 1)
    return margin + int(np.argmax(gain[margin : n - margin]))


def _line(times: FloatArray, left: FloatArray, own: FloatArray) -> _Cause | None:
    """Return the line that stands highest above the noise beside it, None where stamps show no lines."""
    period = float(np.median(np.diff(times)))
    places = np.round((times - times[0]) / period).astype(np.intp)
    length = int(places[-1]) + 1
    if length > 4 * len(times) or length < 4 * _AROUND:
        return None
    even = np.zeros(length)
    even[places] = left
    n_fft = next_fast_len(length, real=True)
    power = np.square(np.abs(rfft(even * np.hanning(length), n_fft)))
    width = 2 * _AROUND + 1
    if len(power) <= width:
        return None
    sums = np.concatenate([[0.0], np.cumsum(power)])
    lines = np.arange(_AROUND, len(power) - _AROUND)
    around = sums[lines + _AROUND + 1] - sums[lines - _AROUND]
    near = sums[lines + _BESIDE + 1] - sums[lines - _BESIDE]
    level = np.maximum(around - near, 1e-12 * sums[-1]) / (width - 2 * _BESIDE - 1)
    place = _AROUND + int(np.argmax(power[lines] / level))
    looks = 0.5 * length * _CAREFUL
    if power[place] < 0.5 * math.log(looks / _LEVEL) * level[place - _AROUND]:
        return None  # half of what a line needs to stand out, as those between two lines have less in each
    finer = (place + np.linspace(-1.0, 1.0, 2 * _FINER + 1)) / (n_fft * period)
    turning = np.exp(-2j * np.pi * np.outer(finer, times - times[0]))
    hertz = float(finer[int(np.argmax(np.abs(turning @ left)))])
    phase = 2.0 * np.pi * hertz * times
    seen = ", ".join(
        f"{mains:g} Hz at {abs(mains - round(mains * period) / period):.4g} Hz" for mains in _MAINS_HZ
    )
    return _Cause(
        "line",
        np.column_stack([np.cos(phase), np.sin(phase)]),
        own,
        looks,
        lambda c: (
            f"like a line at {hertz:.4g} Hz with an amplitude of {math.hypot(c[0], c[1]):.3g}: hum (at these stamps "
            f"mains show {seen}), or a mode that the model lacks"
        ),
    )


def _said(text: str, _: FloatArray) -> str:
    return text


def input_misfit_warnings(
    name: str,
    drive: InputSignal,
    part: Part,
    respond: Callable[[InputSignal], FloatArray],
) -> list[str]:
    """Return what the residuals of an output to one input say of that input: bent, late, or later than its effect.

    Parameters
    ----------
    name : str -- of the output
    drive : InputSignal
    part : tuple -- stamps [s], what the model says there and what it leaves
    respond : callable -- of an input: what the model says of it at these stamps

    Notes
    -----
    What the input does later, freed of what it did before, has no share in an output that it causes.
    """
    times, modelled, residuals = part
    n, size, moves = len(times), float(np.std(modelled)), float(np.std(drive.values))
    if n < _MIN_SAMPLES or not size > 0.0 or not moves > 0.0 or are_rounding(modelled + residuals, residuals):
        return []
    model = (modelled - np.mean(modelled)) / size
    left = residuals.copy()
    left[outliers(left)] = 0.0
    own = np.column_stack([model, np.gradient(model, times)])
    bent = respond(replace(drive, values=(drive.values / moves) ** 3, sigma=0.0, gaps=()))
    period = float(np.median(np.diff(times)))
    lags = period * np.arange(-_BEFORE, _AFTER + 1)
    around = np.interp(times[:, None] + lags, drive.times_s, drive.values)
    whitened = _Whitened.of(left)
    lately = around[:, : _BEFORE + 1]
    before = LinearSolution.of(lately).basis
    later = around[:, _BEFORE + 1 :] - before @ (before.T @ around[:, _BEFORE + 1 :])
    acted = drive.name
    looks = {
        f"as if {acted} were not what acted: they hold the answer to its cube (a saturating actuator)": bent[
            :, None
        ],
        f"like what {acted} does later: input and output are swapped, or a loop is closed around them": later,
        f"like what {acted} did just before: its delay, hold or clock or the output's exposure is not as stated, "
        "or the degrees are too low": lately,
    }
    causes = [
        _Cause("input", columns, own, 1.0, functools.partial(_said, said)) for said, columns in looks.items()
    ]
    gains = dict(zip(looks, whitened.gains(causes), strict=True))
    best = max(gains, key=lambda said: gains[said])
    return [f"Misfit of {name}: the residuals look {best}."] if gains[best] > 0.0 else []
