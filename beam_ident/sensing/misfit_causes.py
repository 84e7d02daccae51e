"""What the residuals of a fit look like: the likeliest cause of a misfit, named with its size and its instant.

Residuals that are not noise say more than that.  Stamps that are late leave a multiple of the model's own slope, a
wrong clock the slope times time, a sensor that came loose the model itself from some instant on.  Each cause is a
few columns; it is named where these columns explain more of the residuals than noise of the residuals' colour would.

How often it is wrong: ``_LEVEL`` for each of eleven kinds, divided by the instants or frequencies at which a kind was
looked for, is one output in a thousand.  Of 1600 records of 1000 samples under white noise, a moving average, AR(0.9)
and a wide resonance, two were given a cause; of 900 under noise as slow as a tenth to a half of the record, AR(0.99)
to AR(0.998), none was said to drift.  A resonance as sharp as a line is said to be one more often (2 %).  A column
that the model could explain by other parameters makes the test careful, never bold: residuals are at right angles to
those parts.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.special import chdtrc as chi_squared_sf

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.records import InputSignal
from beam_ident.noise.autoregression import autoregression
from beam_ident.noise.outliers import outliers
from beam_ident.noise.scores import ScoreTest, are_rounding
from beam_ident.numerics.convolution import causal_convolution
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.numerics.recursions import one_pole

Part = tuple[FloatArray, FloatArray, FloatArray]  # times [s], modelled, residuals of one record
_LEVEL = 1e-4  # chance of a false alarm for each kind of cause
_LIKE_COLOUR = ("line", "jump", "drift")  # which an autoregression would take for its own
_LARGE = (*_LIKE_COLOUR, "gain")  # which may be most of what is left: looked for in it as it is, too
_CAREFUL = 100.0  # times rarer these must be: the colour without them is one that they chose
_MOST = 0.8  # of the square of what is left
_SLOW_BIAS = 15.0  # samples' worth
_SLOW_DOUBT = (
    3.0  # standard deviations of an estimated pole near one: where noise may be slower than it looks
)
_MIN_SAMPLES = 60
_MOST_CAUSES = 3
_MARGIN = 0.05  # of the record, at either end: a change there cannot be told from an end of the motion
_AROUND = 16  # lines on either side that say how loud the noise beside a line is
_BESIDE = 3  # of them next to the line, which belong to it
_FINER = 8  # steps between two lines
_BEFORE, _AFTER = 8, 3  # samples of an input around a stamp
_MAINS_HZ = (50.0, 60.0)
_CORNERS = (1.0, 4.0, 16.0, 64.0)  # of a high-pass: so many times below the usual frequency of the model
_AT_ONCE = 8192  # samples: what their columns need stays in the cache
_BENT = "as if {} were not what acted: they hold the answer to its cube (a saturating actuator)"
_NOTHING = 1e-10  # of a column's square: what remains of it then is rounding


Column = Callable[[slice], FloatArray]  # what a cause leaves at some of the samples, shape (n,) or (k, n)
Turn = Callable[
    [FloatArray], FloatArray
]  # of columns, shape (n, k), which makes noise of a known colour white


@dataclass(frozen=True, eq=False)
class Noise:
    """What is known of the noise in one record of an output.

    Attributes
    ----------
    spread : ndarray, shape (n,) or (1,) -- how loud it is at every sample, over the record's
    turn : callable or None -- the map that makes it white, where its colour is known: that from a noisy input
    """

    spread: FloatArray = field(default_factory=lambda: np.ones(1))
    turn: Turn | None = None


_EVEN = Noise()


@dataclass(frozen=True, eq=False)
class _Cause:
    """A kind of cause, its columns where it explains most, and how it is said."""

    kind: str
    columns: tuple[str, ...]  # by name
    beside: tuple[str, ...]  # what other values of the fit's own parameters may leave
    looks: float  # at how many places it was looked for, and how much more careful that has to be
    said: Callable[[FloatArray], str]  # of the coefficients


def misfit_warnings(
    outputs: Sequence[tuple[str, Sequence[Part]]], noises: Sequence[Sequence[Noise]] | None = None
) -> list[str]:
    """Return what the residuals of outputs look like, one sentence for each output that has more than noise.

    Parameters
    ----------
    outputs : sequence of (name, records)
        Of every output, record by record: stamps [s], what the model says there and what it leaves, each (n,).
    noises : sequence of (sequence of Noise) or None -- of the same records, where something is known of it
    """
    warnings = []
    for (name, parts), own in zip(outputs, noises or [[_EVEN] * len(o[1]) for o in outputs], strict=True):
        pairs = zip(parts, own, strict=True)
        found = dict.fromkeys(said for part, noise in pairs for said in _causes(*part, noise))
        if found:
            warnings.append(
                f"Misfit of {name}: the residuals look {'; and '.join(found)}. If that is so, poles are biased."
            )
    return warnings


def _causes(times: FloatArray, modelled: FloatArray, residuals: FloatArray, noise: Noise) -> list[str]:
    """Return the causes in one record, the one that explains most first."""
    n, size = len(times), float(np.std(modelled))
    if n < _MIN_SAMPLES or not size > 0.0 or are_rounding(modelled + residuals, residuals):
        return []
    left = residuals / noise.spread
    left[outliers(left)] = 0.0  # they are named by themselves
    columns = _columns(times, (modelled - np.mean(modelled)) / size, float(np.std(residuals)) / size)
    if len(noise.spread) == n and np.any(noise.spread != 1.0):
        columns = {
            name: functools.partial(_weighed, own, 1.0 / noise.spread) for name, own in columns.items()
        }
    found: list[str] = []
    kinds: set[str] = set()
    for _ in range(_MOST_CAUSES):
        whitened = _Whitened.of(left, turn=noise.turn)
        causes = [c for c in _candidates(times, columns, left, whitened, size) if c.kind not in kinds]
        # White residuals have no colour that could have taken up a line or a step.
        is_coloured = len(whitened.colour) > 1
        apart = [c for c in causes if is_coloured and c.kind in _LIKE_COLOUR]
        together = [c for c in causes if c not in apart]
        # What a changed gain leaves has the colour of the model; noise of that colour follows the model in part only.
        apart += [c for c in together if is_coloured and c.kind in _LARGE and _is_most(c, columns, left)]
        gains = list(zip(together, whitened.gains(columns, together), strict=True))
        for cause in apart:
            without = _without(cause, columns, left, noise.turn)
            slowness = without.slowness() if cause.kind == "drift" else 1.0
            gains.append((cause, without.gains(columns, [cause], slowness)[0]))
        best, best_gain = None, 0.0
        for cause, gain in gains:
            if gain > best_gain and _stands_without_weights(cause, columns, left, modelled):
                best, best_gain = cause, gain
        if best is None:
            break
        kinds.add(best.kind)
        design = _stacked(columns, (*best.columns, *best.beside), n)
        coefficients = LinearSolution.of(_turned(design, noise.turn)).coefficients(
            _turned(left[:, None], noise.turn)[:, 0]
        )
        found.append(best.said(coefficients))
        left = left - design @ coefficients
    return found


def _turned(columns: FloatArray, turn: Turn | None) -> FloatArray:
    """Return columns, shape (n, k), where noise of a known colour is white."""
    return columns if turn is None else turn(columns)


def _stacked(columns: Mapping[str, Column], names: Sequence[str], n: int) -> FloatArray:
    """Return columns side by side, shape (n, k)."""
    return np.asarray(np.concatenate([np.atleast_2d(columns[name](slice(0, n))) for name in names]).T)


def _without(cause: _Cause, columns: Mapping[str, Column], left: FloatArray, turn: Turn | None) -> _Whitened:
    """Return residuals whitened by the colour that they have without a cause.

    A line or a step is itself the limit of a colour, an autoregression with a pole on the unit circle, which would
    leave nothing of it.
    """
    names = cause.columns if cause.kind in _LIKE_COLOUR else (*cause.columns, *cause.beside)
    cause_alone = LinearSolution.of(_stacked(columns, names, len(left)))
    return _Whitened.of(left, cause_alone.left_of(left), turn)


def _is_most(cause: _Cause, columns: Mapping[str, Column], left: FloatArray) -> bool:
    """Return whether a cause explains most of what other values of the fit's own parameters leave."""
    beside, whole = (
        LinearSolution.of(_stacked(columns, names, len(left))).basis
        for names in (cause.beside, (*cause.beside, *cause.columns))
    )
    without, with_it = (float(left @ left - np.sum(np.square(own.T @ left))) for own in (beside, whole))
    return with_it < (1.0 - _MOST) * without


def _stands_without_weights(
    cause: _Cause, columns: Mapping[str, Column], left: FloatArray, values: FloatArray
) -> bool:
    """Return whether a cause that a fit could take up itself stands out of residuals without weights as well.

    A fit that does not weigh by the colour of its noise errs by more than one that does, and along these columns.
    """
    if cause.kind not in ("late", "exposure"):
        return True
    own, beside = (_stacked(columns, names, len(left)) for names in (cause.columns, cause.beside))
    return ScoreTest.of([(own, LinearSolution.of(beside), left, values)]).p_value < _LEVEL


@dataclass(frozen=True)
class _Whitened:
    """Residuals as their autoregression leaves them, behind what is known of their colour.

    With the colour of the residuals with everything in them, what columns explain beyond it is the score of a
    Lagrange multiplier test, whose level holds for noise of any stationary colour.
    """

    colour: FloatArray
    left: FloatArray
    turn: Turn | None

    @staticmethod
    def of(left: FloatArray, noise: FloatArray | None = None, turn: Turn | None = None) -> _Whitened:
        """Whiten residuals by the colour of their own, or of what is known to be noise."""
        known = left if noise is None else noise
        left, known = _turned(np.stack([left, known], axis=1), turn).T
        colour = autoregression(known)
        white = left if len(colour) == 1 else causal_convolution(colour, left)[len(colour) - 1 :]
        return _Whitened(colour, white, turn)

    def column(self, column: FloatArray) -> FloatArray:
        """Whiten a column, shape (n,)."""
        column = _turned(column[:, None], self.turn)[:, 0]
        if len(self.colour) == 1:
            return column
        return causal_convolution(self.colour, column)[len(self.colour) - 1 :]

    def products(self, parts: Sequence[Column]) -> tuple[FloatArray, FloatArray, list[int]]:
        """Return the inner products of whitened columns with each other and with residuals, and their numbers.

        They are taken block by block: of a long record no column is kept, but where noise of a known colour is
        turned white.
        """
        n_before, n = len(self.colour) - 1, len(self.left)
        squares, products, widths = np.zeros((0, 0)), np.zeros(0), [0] * len(parts)
        at_once = _AT_ONCE if self.turn is None else n
        for first in range(0, n, at_once):
            last = min(first + at_once, n)
            here = slice(first, last + n_before)  # a filter looks back by its order
            columns = [np.atleast_2d(part(here)) for part in parts]
            widths, rows = [len(own) for own in columns], np.concatenate(columns)
            rows = _turned(rows.T, self.turn).T
            if n_before:
                rows = causal_convolution(self.colour, rows)[:, n_before:]
            if not first:
                squares, products = np.zeros((len(rows), len(rows))), np.zeros(len(rows))
            squares += rows @ rows.T
            products += rows @ self.left[first:last]
        return squares, products, widths

    def slowness(self) -> float:
        """Return by how much more slow power noise may have than its colour says, from which drifts were taken.

        Notes
        -----
        A pole near one is estimated too small, the more so the more drifts are taken out before: by about ``c/n`` of
        n samples (Kendall, Biometrika 41 (1954), 403), where c grows from 4 with an offset to 15 or 20 with a cubic.
        It scatters by ``sqrt((1 - a^2) / n)`` (Mann and Wald, Econometrica 11 (1943), 173): of a pole that is not
        known to be away from one, nothing slow is told from noise.
        """
        roots = np.roots(self.colour)
        slowest = max((float(root.real) for root in roots if abs(root.imag) < 1e-9), default=0.0)
        n = len(self.left) + len(self.colour) - 1
        doubt = _SLOW_DOUBT * math.sqrt((1.0 - slowest**2) / n) if slowest > 0.0 else 0.0
        surely = 1.0 - slowest - _SLOW_BIAS / n - doubt
        return ((1.0 - slowest) / surely) ** 2 if surely > 0.0 else math.inf

    def gains(
        self, columns: Mapping[str, Column], causes: Sequence[_Cause], slowness: float = 1.0
    ) -> list[float]:
        """Return each cause's gain in log-likelihood less what it costs, 0 where noise would gain as much.

        Parameters
        ----------
        columns : mapping -- by their names
        causes : sequence of _Cause
        slowness : float -- by how much more noise explains along the columns than its colour says
        """
        names = list(dict.fromkeys(name for cause in causes for name in (*cause.columns, *cause.beside)))
        squares, products, widths = self.products([columns[name] for name in names])
        ends = np.cumsum(widths).tolist()
        rows = {name: range(end - width, end) for name, width, end in zip(names, widths, ends, strict=True)}
        products = products / math.sqrt(slowness)
        return self.gains_of(squares, products, [_Places.of(cause, rows) for cause in causes])

    def gains_of(self, squares: FloatArray, products: FloatArray, causes: Sequence[_Places]) -> list[float]:
        """Return the same from the inner products of all columns, and the places of each cause's own among them."""
        size = np.sqrt(np.diag(squares))
        size[size == 0.0] = 1.0
        squares, products, power = (
            squares / np.outer(size, size),
            products / size,
            float(self.left @ self.left),
        )
        known = {
            beside: np.linalg.pinv(squares[np.ix_(beside, beside)], rcond=_NOTHING, hermitian=True)
            for beside in {cause.beside for cause in causes}
        }
        found = []
        for cause in causes:
            own, beside = list(cause.own), list(cause.beside)
            # At right angles to what the fit's own parameters may leave.
            share = squares[np.ix_(own, beside)] @ known[cause.beside]
            scores = products[own] - share @ products[beside]
            inner = squares[np.ix_(own, own)] - share @ squares[np.ix_(beside, own)]
            left = power - float(products[beside] @ known[cause.beside] @ products[beside])
            found.append(self._gain(inner, scores, left, cause.looks))
        return found

    def _gain(self, inner: FloatArray, scores: FloatArray, power: float, looks: float) -> float:
        """Return what columns of some inner products gain that have ``scores`` with residuals of some power."""
        levels, vectors = np.linalg.eigh(inner) if len(inner) > 1 else (inner[0], np.ones((1, 1)))
        is_seen = levels > _NOTHING
        n, k = len(self.left), int(np.count_nonzero(is_seen))
        if not k or not power > 0.0:
            return 0.0
        explained = float(np.sum(np.square(vectors.T @ scores)[is_seen] / levels[is_seen]))
        left_over = max(power - explained, 1e-12 * power)
        if chi_squared_sf(k, (n - k) * (1.0 - left_over / power)) > _LEVEL / looks:
            return 0.0
        return float(0.5 * n * math.log(power / left_over) - 0.5 * k * math.log(n) - math.log(looks))


@dataclass(frozen=True)
class _Places:
    """Where among all columns those of a cause stand."""

    own: tuple[int, ...]
    beside: tuple[int, ...]
    looks: float

    @staticmethod
    def of(cause: _Cause, rows: Mapping[str, range]) -> _Places:
        """Look the names up."""
        own, beside = (
            tuple(place for name in given for place in rows[name]) for given in (cause.columns, cause.beside)
        )
        return _Places(own, beside, cause.looks)


def _columns(times: FloatArray, model: FloatArray, noise: float) -> dict[str, Column]:
    """Return what causes leave of a record, by name; those that no search is needed for.

    Parameters
    ----------
    times, model : ndarray, shape (n,) -- stamps [s], and what the model says there in units of its own size
    noise : float -- of the residuals, in the same units: a dead band takes as much from every value beyond it
    """
    slope = np.gradient(model, times)
    curvature = np.gradient(slope, times)
    middle, half = 0.5 * float(times[0] + times[-1]), 0.5 * float(times[-1] - times[0])

    def powers(here: slice) -> FloatArray:
        share = (times[here] - middle) / half
        squared = np.square(share)
        return np.stack([np.ones_like(share), share, squared, squared * share])

    def bent(here: slice) -> FloatArray:
        own = model[here]
        squared = np.square(own)
        return np.stack([own * np.abs(own), squared, squared * own])

    return {
        "model": lambda here: model[here],
        "slope": lambda here: slope[here],
        "curvature": lambda here: curvature[here],
        "slope by time": lambda here: (times[here] - middle) * slope[here],
        "bent": bent,
        "sign": lambda here: np.tanh(model[here] / noise),
        "powers": powers,
        "one": lambda here: np.ones(len(times[here])),
        **_slow_parts(times, model),
    }


def _candidates(
    times: FloatArray,
    columns: dict[str, Column],
    left: FloatArray,
    whitened: _Whitened,
    size: float,
) -> list[_Cause]:
    """Return every kind of cause, at the instant or the frequency where it explains most.

    Columns of such an instant or frequency are added to the others.
    """
    n, own = len(times), ("model", "slope")
    causes = [
        _Cause(
            "late",
            ("slope",),
            ("model",),
            1.0,
            lambda c: (
                f"as if its stamps were {-1e3 * c[0] / size:.3g} ms late (its delay or latency, the input's hold or "
                "the clocks are not as stated)"
            ),
        ),
        _Cause(
            "clock",
            ("slope by time",),
            own,
            1.0,
            lambda c: f"as if its clock ran {-100.0 * c[0] / size:+.2g} % fast",
        ),
        _Cause(
            "exposure",
            ("curvature",),
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
            ("bent",),
            own,
            1.0,
            lambda c: (
                "nonlinear: they follow squares and cubes of the output (dead band, saturation, bent scale)"
            ),
        ),
        _Cause(
            "dead band",
            ("sign", "bent"),
            own,
            1.0,
            lambda c: (
                "nonlinear: they follow the sign of the output and its powers (dead band, play, friction)"
            ),
        ),
        _Cause(
            "drift",
            ("powers",),
            own,
            _CAREFUL,
            lambda c: (
                "like an offset or a drift that the model does not have (has_offset, has_ramp), or slow noise"
            ),
        ),
    ]
    slow = [name for name in columns if name.startswith("slow")]
    causes += [_Cause("slow", (name,), own, len(slow), lambda c: slow_answer(c[0] / size)) for name in slow]
    changes: list[tuple[str, str, Callable[..., str]]] = [
        ("gain", "model", lambda c, at: (
            f"as if its gain changed by {c[0] / size:+.0%} at {at:.4g} s (a loose sensor, a channel dead or swapped)"
        )),
        ("jump", "one", lambda c, at: f"as if its offset jumped by {c[0]:+.3g} at {at:.4g} s"),
        ("clock jump", "slope", lambda c, at: (
            f"as if its stamps were {-1e3 * c[0] / size:.3g} ms late from {at:.4g} s on (a clock that jumped)"
        )),
    ]  # fmt: skip
    for kind, name, said in changes:
        column, places = columns[name](slice(0, n)), {}
        if kind not in _LIKE_COLOUR:
            white = whitened.column(column)
            places[kind] = n - len(white) + _change(white, whitened.left)
        if kind in _LARGE:
            places[f"large {kind}"] = _change(column, left)
        looks = n * (_CAREFUL if kind in _LIKE_COLOUR else 1.0)
        beside = tuple(dict.fromkeys((*own, name)))
        for own_name, place in places.items():
            columns[own_name] = functools.partial(_after, columns[name], place)
            told = functools.partial(said, at=float(times[place]))
            causes.append(_Cause(kind, (own_name,), beside, looks, told))
    line = _line(times, _turned(left[:, None], whitened.turn)[:, 0], own)
    if line is not None:
        cause, columns["line"] = line
        causes.append(cause)
    return causes


def slow_answer(share_hz: float) -> str:
    """Return what leaves the slow part of a signal: its integral times ``2 pi share_hz`` [Hz], to first order."""
    if share_hz > 0.0:
        return "as if something slow followed it (creep, a load that warms, a loop that integrates)"
    return f"as if it were coupled through a high-pass (AC, a charge amplifier) at about {-share_hz:.2g} Hz"


def _slow_parts(times: FloatArray, model: FloatArray) -> dict[str, Column]:
    """Return what low-passes leave of a model, over their corners [s], by name.

    Far above its corner a low-pass is an integral, whatever the corner: a few of them will do.
    """
    period = float(np.median(np.diff(times)))
    speed = float(np.std(np.diff(model))) / (2.0 * math.pi * period * max(float(np.std(model)), 1e-300))
    found: dict[str, Column] = {}
    for share in _CORNERS:
        corner = max(speed / share, 1.0 / (period * len(times)))
        kept = math.exp(-2.0 * math.pi * corner * period)
        column = one_pole(kept, (1.0 - kept) / corner * model)
        found[f"slow, {share:g}"] = functools.partial(np.ndarray.__getitem__, column)
    return found


def _weighed(column: Column, weights: FloatArray, here: slice) -> FloatArray:
    """Return a column as noise that differs from sample to sample shows it."""
    return np.asarray(column(here) * weights[here])


def _after(column: Column, place: int, here: slice) -> FloatArray:
    """Return a column that is nothing before some sample."""
    result = np.array(column(here))
    result[: max(place - here.start, 0)] = 0.0
    return result


def _change(column: FloatArray, left: FloatArray) -> int:
    """Return the sample from which on a column, freed of its whole, explains most of what is left."""
    n = len(column)
    margin = max(int(_MARGIN * n), 1)
    inside = slice(margin - 1, n - margin - 1)  # up to the sample before
    before, squares = np.cumsum(column * left), np.cumsum(np.square(column))
    total, power = float(before[-1]), float(squares[-1])
    # The column from an instant on, or up to it, at right angles to the whole column: one is less the other.
    own = squares[inside]
    inner = own * (1.0 - own / power)
    gain = np.square(before[inside] - own * (total / power)) / np.maximum(inner, _NOTHING * power)
    return margin + int(np.argmax(gain))


def _line(times: FloatArray, left: FloatArray, own: tuple[str, ...]) -> tuple[_Cause, Column] | None:
    """Return the line that stands highest above the noise beside it, None where stamps show no lines."""
    period = float(np.median(np.diff(times)))
    places = np.round((times - times[0]) / period).astype(np.intp)
    length = int(places[-1]) + 1
    if length > 4 * len(times) or length < 4 * _AROUND:
        return None
    even = np.zeros(length)
    even[places] = left
    n_fft = next_fast_len(length, real=True)
    spectrum = rfft(even * np.hanning(length), n_fft)
    power = np.square(spectrum.real) + np.square(spectrum.imag)
    width = 2 * _AROUND + 1
    if len(power) <= width:
        return None
    sums = np.concatenate([[0.0], np.cumsum(power)])
    lines = slice(_AROUND, len(power) - _AROUND)
    around = sums[width:] - sums[:-width]
    nearest = 2 * _BESIDE + 1
    near = (sums[nearest:] - sums[:-nearest])[_AROUND - _BESIDE : _BESIDE - _AROUND]
    level = np.maximum(around - near, 1e-12 * sums[-1]) / (width - nearest)
    place = _AROUND + int(np.argmax(power[lines] / level))
    looks = 0.5 * length * _CAREFUL
    if power[place] < 0.5 * math.log(looks / _LEVEL) * level[place - _AROUND]:
        return None  # half of what a line needs to stand out, as those between two lines have less in each
    finer = (place + np.linspace(-1.0, 1.0, 2 * _FINER + 1)) / n_fft
    hertz = float(finer[int(np.argmax(np.abs(_transform(even, finer))))]) / period
    seen = ", ".join(
        f"{mains:g} Hz at {abs(mains - round(mains * period) / period):.4g} Hz" for mains in _MAINS_HZ
    )

    def column(here: slice) -> FloatArray:
        phase = 2.0 * np.pi * hertz * times[here]
        return np.stack([np.cos(phase), np.sin(phase)])

    cause = _Cause(
        "line",
        ("line",),
        own,
        looks,
        lambda c: (
            f"like a line at {hertz:.4g} Hz with an amplitude of {math.hypot(c[0], c[1]):.3g}: hum (at these stamps "
            f"mains show {seen}), or a mode that the model lacks"
        ),
    )
    return cause, column


def _transform(values: FloatArray, cycles: FloatArray) -> ComplexArray:
    """Return the Fourier transform of even samples at some frequencies, in cycles a sample.

    The turn up to a sample is that to the row it stands in, times that within the row: few turns, and one product.
    """
    width = math.isqrt(len(values)) + 1
    rows = np.zeros(width * width)
    rows[: len(values)] = values
    turns = np.exp(-2j * np.pi * np.outer(cycles, np.arange(width)))
    within = rows.reshape(width, width) @ np.concatenate([turns.real, turns.imag]).T
    inner = within[:, : len(cycles)] + 1j * within[:, len(cycles) :]
    outer = np.exp(-2j * np.pi * width * np.outer(np.arange(width), cycles))
    return np.asarray(np.sum(inner * outer, axis=0))


def input_misfit_warnings(
    name: str,
    drive: InputSignal,
    part: Part,
    respond: Callable[[InputSignal], FloatArray],
    only_bent: bool = False,
) -> list[str]:
    """Return what the residuals of an output to one input say of that input: bent, late, or later than its effect.

    Parameters
    ----------
    name : str -- of the output
    drive : InputSignal
    part : tuple -- stamps [s], what the model says there and what it leaves
    respond : callable -- of an input: what the model says of it at these stamps
    only_bent : bool
        Whether the input may go with the residuals for other reasons: in a loop it follows the noise of the output,
        and errors of its own measurement are in both.

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
    own = np.stack([model, np.gradient(model, times)])
    bent = respond(cubed(drive))
    lags = float(np.median(np.diff(times))) * np.arange(-_BEFORE, _AFTER + 1)

    def around(here: slice) -> FloatArray:
        return np.interp(times[here] + lags[:, None], drive.times_s, drive.values)

    # What the input does later is freed of what it did before, whatever the colour of the residuals.
    n_lately, n_around = _BEFORE + 1, len(lags)
    plain, _, _ = _Whitened(np.ones(1), left, None).products([around])
    known = LinearSolution.of(plain[:n_lately, :n_lately]).coefficients(plain[:n_lately, n_lately:])
    whitened = _Whitened.of(left)
    columns: list[Column] = [around, lambda here: bent[here], lambda here: own[:, here]]
    squares, products, _ = whitened.products(columns)
    free = np.eye(len(squares))
    free[n_lately:n_around, :n_lately] = -known.T
    squares, products = free @ squares @ free.T, free @ products
    lately, later = tuple(range(n_lately)), tuple(range(n_lately, n_around))
    beside = (n_around + 1, n_around + 2)
    acted = drive.name
    looks = {
        _BENT.format(acted): (n_around,),
        f"like what {acted} does later: input and output are swapped, or a loop is closed around them": later,
        f"like what {acted} did just before: its delay, hold or clock or the output's exposure is not as stated, "
        "or the degrees are too low": lately,
    }
    if only_bent:
        looks = dict([next(iter(looks.items()))])
    causes = [_Places(places, beside, 1.0) for places in looks.values()]
    gains = dict(zip(looks, whitened.gains_of(squares, products, causes), strict=True))
    best = max(gains, key=lambda said: gains[said])
    return [f"Misfit of {name}: the residuals look {best}."] if gains[best] > 0.0 else []


def cubed(drive: InputSignal) -> InputSignal:
    """Return the cube of an input that moves, in units of its standard deviation."""
    return replace(drive, values=(drive.values / float(np.std(drive.values))) ** 3, sigma=0.0, gaps=())


def bent_input_warning(name: str, input_name: str) -> str:
    """Return what must be known of an output whose residuals hold the answer to the cube of an input."""
    return f"Misfit of {name}: the residuals look {_BENT.format(input_name)}."
