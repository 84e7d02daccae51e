"""Whole periods of a periodic record: Fourier coefficients of inputs and outputs, period by period.

The input's coefficients follow exactly from its samples and its hold, images included.  Outputs whose period
is a whole number of samples are transformed as they are, and what lies above half their rate folds onto the
lines below it.  Outputs at any other stamps, or with samples missing, are fitted by the harmonics of the period,
least squares over the samples of each period: the normal equations are Toeplitz, whatever the stamps are.  As long
as no hole between stamps reaches half the period of the highest line, these are well conditioned (Groechenig 1992);
a period with a longer hole is left out.

Equation numbers are those of docs/frequency-equations.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from beam_ident.arrays import AnyArray, BoolArray, ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import finite_row, poor_gaps, require_output
from beam_ident.data.frequency_record import TAIL_POWERS, Folding
from beam_ident.data.gaps import describe_gaps
from beam_ident.data.records import InputSignal, OutputSignal
from beam_ident.errors import EstimationError
from beam_ident.numerics.piecewise import HOLDS, Hold, Instants, PiecewisePolynomial, regular_period

_MAX_MISSING = 0.02
_LINE_TOLERANCE = 1e-6  # of a period: how whole a number of samples must be
_EXCITED = 1e-3  # of the strongest line: what counts as excited where nobody says
_IMAGE_FLOOR = 1e-6  # of the line: images that matter less go into the tail
_MAX_IMAGES = 32
_IMAGES_ABOVE = 8  # multiples of the input's rate up to which images are looked at
_AUDIBLE = 15.0  # times the noise's power: below this a line of the input holds nothing but noise
ENOUGH_FREEDOM = 40.0
"""Degrees of freedom at which a variance weighs almost as a known one."""

_HARMONICS = 3  # of the highest line, that a fit of harmonics takes along
_ENDS = 2.5  # steps between samples, that the last period may lack
_FITTED = 0.4  # of the samples in a period: lines that a fit of harmonics bears


# The B-spline of degree 9 at 0 and twice at 1 .. 4 samples from its middle: Eulerian numbers over 9!.
_BASIS_OF_DEGREE_9 = np.array([156190.0, 176468.0, 29216.0, 1004.0, 2.0]) / 362880.0


def hold_gain(hold: Hold, omegas: FloatArray, period_s: float) -> ComplexArray:
    """Return the Fourier coefficient of a held signal over that of its samples.

    Parameters
    ----------
    hold : {"zoh", "linear", "cubic", "band_limited"}
    omegas : ndarray -- any frequencies, images included [rad/s]
    period_s : float -- of the samples [s]

    Notes
    -----
    With ``x = omega T / 2``: zero-order hold ``sinc(x) e^(-jx)``, straight lines ``sinc(x)^2``, the cubic
    spline ``3 sinc(x)^4 / (2 + cos 2x)`` (Unser 1999, for the cardinal spline), and likewise the
    spline of degree 9 ``sinc(x)^10`` over the transform of its basis at the samples.
    """
    half = 0.5 * np.asarray(omegas, dtype=np.float64) * period_s
    sinc = np.sinc(half / np.pi)
    if hold == "zoh":
        return np.asarray(sinc * np.exp(-1j * half))
    if hold == "linear":
        return np.asarray(sinc**2 + 0j)
    if hold == "cubic":
        return np.asarray(3.0 * sinc**4 / (2.0 + np.cos(2.0 * half)) + 0j)
    if hold == "band_limited":
        cosines = np.cos(np.multiply.outer(half, 2.0 * np.arange(5)))
        return np.asarray(sinc**10 / (cosines @ _BASIS_OF_DEGREE_9) + 0j)
    raise EstimationError(f"the hold {hold!r} has no Fourier gain here; expected {', '.join(HOLDS)}")


def exposure_gain(omegas: FloatArray, exposure_s: float) -> FloatArray:
    """Return what the box average over an exposure leaves of a frequency."""
    return np.asarray(np.sinc(np.asarray(omegas) * exposure_s / (2.0 * np.pi)))


def angular(numbers: IndexArray, line_period_s: float) -> FloatArray:
    """Return the frequencies of line numbers [rad/s]."""
    return np.asarray(2.0 * np.pi * numbers / line_period_s, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class PeriodicInput:
    """The input's periods that go with the outputs' periods."""

    signal: InputSignal
    period_s: float
    per_period: int
    ticks: FloatArray  # (n_periods, per_period)
    first_s: float  # when the outputs' first period begins
    start_s: float  # of the first tick, relative to that

    @staticmethod
    def of(
        drive: InputSignal, first_s: float, n_periods: int, line_period_s: float, half: float
    ) -> PeriodicInput:
        """Cut an input to the periods that begin at ``first_s`` [s], half an exposure before that included."""
        period = drive.period_s
        if period is None:
            raise EstimationError(
                f"input {drive.name!r} has irregular stamps; a periodic response needs a regular input. "
                "Fit a model instead: identify() takes any stamps"
            )
        count = line_period_s / period
        if not 4 <= count < math.inf:
            raise EstimationError(
                f"input {drive.name!r}: the period of {line_period_s} s is {count:.4f} samples; expected at least 4. "
                "Give the period of the excitation in s, or sample the input faster"
            )
        per_period = round(count)
        first = int(np.floor((first_s - half - drive.times_s[0]) / period + 1e-6))
        last = first + math.ceil(n_periods * (per_period if is_whole(count) else count))
        if first < 0 or last > len(drive.values):
            raise EstimationError(
                f"input {drive.name!r} is known from {drive.span_s[0]:.3f} to {drive.span_s[1]:.3f} s; the steady "
                f"periods need it from {first_s:.3f} to {first_s + n_periods * line_period_s:.3f} s"
            )
        start = float(drive.times_s[first])
        if is_whole(count):
            ticks = drive.values[first:last].reshape(n_periods, per_period)
        else:
            ticks = _on_whole_ticks(
                drive.times_s[first:last] - start,
                drive.values[first:last],
                n_periods,
                line_period_s,
                per_period,
            )
            period = line_period_s / per_period
        return PeriodicInput(drive, period, per_period, ticks, first_s, start - first_s)

    def coefficients(self, numbers: IndexArray, line_period_s: float) -> ComplexArray:
        """Return the Fourier coefficients at any line numbers, shape (n_periods, n_numbers)."""
        spectra = np.fft.fft(self.ticks, axis=1) / self.per_period
        omegas = angular(numbers, line_period_s)
        # (F.3): the samples' spectrum is periodic in the line number, the hold's gain is not.
        gain = hold_gain(self.signal.hold, omegas, self.period_s) * np.exp(-1j * omegas * self.start_s)
        return np.asarray(spectra[:, numbers % self.per_period] * gain)

    def known(self, spectra: ComplexArray, periods: IndexArray) -> tuple[ComplexArray, IndexArray]:
        """Return the spectra, shape (n_outputs, n_periods, n_bins), of those periods in which the input is known."""
        poor = poor_gaps(self.signal)
        span = self.per_period * self.period_s
        begins = self.first_s + span * periods
        lost = np.array(
            [any(gap.end_s > t and gap.start_s < t + span for gap in poor) for t in begins], dtype=bool
        )
        if np.count_nonzero(~lost) < 2:
            raise EstimationError(
                f"a periodic response needs two periods in which the input is known. "
                f"{describe_gaps(self.signal.name, poor, self.signal.unit)} Record again without losses, or fit a "
                "model: identify() takes what is known"
            )
        return spectra[:, ~lost], periods[~lost]

    def only(self, periods: IndexArray) -> PeriodicInput:
        """Return some of the periods."""
        return replace(self, ticks=self.ticks[periods])

    def quiet(self, numbers: IndexArray) -> PeriodicInput:
        """Return the mean period as the only one, without lines in which nothing but noise was measured."""
        n_periods = len(self.ticks)
        spectra = np.fft.rfft(self.ticks, axis=1)
        mean = np.mean(spectra, axis=0)
        scatter = np.sum(np.abs(spectra - mean) ** 2, axis=0) / (n_periods - 1) / n_periods
        level = moving_mean(scatter, int(min(np.ceil(ENOUGH_FREEDOM / (n_periods - 1)), len(scatter))))
        # Noise that was measured at the input did not excite anything: it must not enter as an image.
        is_kept = np.abs(mean) ** 2 > _AUDIBLE * level
        is_kept[numbers] = True
        ticks = np.fft.irfft(np.where(is_kept, mean, 0.0), self.per_period)
        return replace(self, ticks=ticks[None])

    def integrals(self, times: FloatArray, exposure_s: float) -> list[FloatArray]:
        """Return second derivative .. second integral of the first period, as the outputs sample it."""
        mean = self.ticks[0]
        samples = np.tile(mean - np.mean(mean), 3)
        ticks = np.arange(len(samples), dtype=np.float64) - self.per_period
        grid: FloatArray = self.start_s + self.period_s * ticks
        hold = self.signal.hold
        own = PiecewisePolynomial.from_samples(grid, samples, hold)
        span = self.per_period * self.period_s
        begin = self.start_s
        chain = [own]
        for _ in range(2):
            integral = chain[-1].antiderivative()
            # Each integral without its mean, so that the next one is periodic as well.
            twice = integral.antiderivative()
            ends = twice(np.array([begin, begin + span]))
            chain.append(integral.shifted(-float(ends[1] - ends[0]) / span))
        instants = Instants.on(own, times, exposure_s)
        found = [np.full(len(times), np.nan)] * 2  # a held input jumps: it has no derivatives
        if hold != "zoh":
            # Where two derivatives are asked of straight lines, the spline through the ticks has them.
            source: Hold = "cubic" if hold == "linear" else hold
            smooth = PiecewisePolynomial.from_samples(grid, samples, source)
            found = [instants.mean(smooth, 2)[0], instants.mean(own, 1)[0]]
        return found + [instants.mean(chain[k])[0] for k in range(3)]


def is_whole(count: float) -> bool:
    """Return whether a period holds a whole number of samples."""
    return abs(round(count) / count - 1.0) <= _LINE_TOLERANCE


def _on_whole_ticks(
    times: FloatArray, values: FloatArray, n_periods: int, line_period_s: float, per_period: int
) -> FloatArray:
    """Return the periods of a signal on a grid that fits them, from the lines that its samples determine."""
    phases = times / line_period_s
    edges = np.searchsorted(phases, np.arange(n_periods + 1) - 1e-9)
    n_lines = int(_FITTED * (per_period - 1))
    rows = []
    for k, (first, last) in enumerate(pairwise(edges)):
        lines = _harmonics(phases[first:last] - k, values[first:last, None], n_lines)[:, 0]
        padded = np.zeros(per_period // 2 + 1, dtype=np.complex128)
        padded[: n_lines + 1] = lines
        rows.append(np.fft.irfft(padded * per_period, per_period))
    return np.array(rows)


@dataclass(frozen=True, eq=False)
class SteadyPeriods:
    """The whole periods of the outputs.

    Attributes
    ----------
    outputs : tuple of OutputSignal -- from the first whole period on, without samples that are missing
    first_s : float -- when the first period begins [s]
    n_periods : int
    line_period_s : float
    grid : ndarray or None, shape (n_outputs, n_periods * per_period)
        The values, NaN where one is missing, where a period is a whole number of common samples; else None.
    """

    outputs: tuple[OutputSignal, ...]
    first_s: float
    n_periods: int
    line_period_s: float
    grid: FloatArray | None

    @staticmethod
    def of(
        outputs: Sequence[OutputSignal], line_period_s: float, start_s: float, end_s: float
    ) -> SteadyPeriods:
        """Cut outputs to their whole periods between two times [s]."""
        stamps = [
            output.times_s[(output.times_s >= start_s - 1e-9) & (output.times_s <= end_s + 1e-9)]
            for output in outputs
        ]
        first = stamps[0]
        if min(map(len, stamps)) < 2:
            raise EstimationError(
                f"output {outputs[0].name!r} has {len(first)} samples between {start_s} and {end_s} s; expected at "
                "least two periods of them"
            )
        period = regular_period(first)
        spacing = max(float(np.median(np.diff(own))) for own in stamps)
        count = line_period_s / (spacing if period is None else period)
        if not 4 <= count < math.inf:
            raise EstimationError(
                f"output {outputs[0].name!r}: the period of {line_period_s} s is {count:.4f} samples; expected at "
                "least 4. Give the period of the excitation in s, or sample faster"
            )
        is_grid = period is not None and is_whole(count)
        is_grid &= all(np.array_equal(own, first) for own in stamps[1:])
        first_s = max(float(own[0]) for own in stamps)
        # A sample that is lost, or late, at the very end takes no period away: holes are judged by themselves.
        reach = min(float(own[-1]) for own in stamps) + _ENDS * spacing - first_s
        whole = len(first) // round(count) if is_grid else math.floor(reach / line_period_s)
        if whole < 2:
            raise EstimationError(
                f"between {start_s} and {end_s} s there are {whole} whole periods of {line_period_s} s; expected at "
                "least two. Record more periods, or give the period of the excitation in s"
            )
        end = first_s + whole * line_period_s - (0.5 * spacing if is_grid else 0.0)
        inside = [(own.times_s >= first_s) & (own.times_s < end) for own in outputs]
        cut = []
        for output, within in zip(outputs, inside, strict=True):
            seen = within & output.is_valid
            require_output(output.name, output.values[seen])
            cut.append(replace(output, times_s=output.times_s[seen], values=output.values[seen]))
        grid = np.array([own.values[inside[0]] for own in outputs]) if is_grid else None
        return SteadyPeriods(tuple(cut), first_s, whole, line_period_s, grid)

    @property
    def per_period(self) -> int | None:
        """Samples in a period, None where that is no whole number."""
        return None if self.grid is None else self.grid.shape[1] // self.n_periods

    def spectra(self, highest: int) -> PeriodSpectra:
        """Return the Fourier coefficients of every period.

        Parameters
        ----------
        highest : int -- number of the highest excited line

        Raises
        ------
        EstimationError
            The stamps do not carry that line, or leave fewer than two periods without a hole.
        """
        if self.grid is not None:
            n = self.grid.shape[1] // self.n_periods
            missing = np.isnan(self.grid)
            if not np.any(missing) or highest > _FITTED * n:
                values = np.array(
                    [
                        _bridged(own, hole, output.name)
                        for own, hole, output in zip(self.grid, missing, self.outputs, strict=True)
                    ]
                )
                level = _level(values.reshape(len(values), self.n_periods, n))
                spectra = np.fft.fft(level, axis=2)[:, :, 1 : (n - 1) // 2 + 1] / n
                return PeriodSpectra(spectra, np.arange(self.n_periods), n)
        return self._fitted(highest)

    def _fitted(self, highest: int) -> PeriodSpectra:
        """Fit harmonics to every period without a long hole, least squares."""
        phases = [(output.times_s - self.first_s) / self.line_period_s for output in self.outputs]
        edges = [np.searchsorted(own, np.arange(self.n_periods + 1)) for own in phases]
        usual = max(float(np.median(np.diff(own))) for own in phases)
        if highest * usual > _FITTED:
            raise EstimationError(
                f"output {self.outputs[0].name!r}: the line at {highest / self.line_period_s:.6g} Hz lies too near "
                f"half the rate of the samples, or above it, and the period of {self.line_period_s:.9g} s is no "
                f"whole number of them. Excite up to {_FITTED / usual / self.line_period_s:.4g} Hz, or choose the "
                "period or the rate so that it is one"
            )
        # The longest hole of every period, from its last sample round to its first one included.
        holes = np.array(
            [
                [_longest_hole(own[first:last] - k) for k, (first, last) in enumerate(pairwise(edge))]
                for own, edge in zip(phases, edges, strict=True)
            ]
        )  # fmt: skip
        longest = np.max(holes, axis=0)
        kept = np.flatnonzero(2.0 * highest * longest < 1.0)
        if len(kept) < 2:
            raise EstimationError(
                f"{len(kept)} of {self.n_periods} periods are without a hole of "
                f"{0.5e3 * self.line_period_s / highest:.3g} ms, half a period of the highest line, in outputs "
                f"{', '.join(o.name for o in self.outputs)}; expected at least two. Record again without losses, or "
                "fit a model: identify() leaves missing samples out"
            )
        fewest = min(int(np.min(np.diff(edge)[kept])) for edge in edges)
        n_bins = max(
            highest, min(_HARMONICS * highest, int(_FITTED * fewest), int(0.5 / float(np.max(longest[kept]))))
        )
        rows = []
        for output, own, edge in zip(self.outputs, phases, edges, strict=True):
            # The record's drift is fitted along: it would leak into every line.
            ramp = own - 0.5 * self.n_periods
            pairs = np.stack([output.values, ramp], axis=1)
            both = np.array(
                [_harmonics(own[edge[k] : edge[k + 1]], pairs[edge[k] : edge[k + 1]], n_bins) for k in kept]
            )
            means = both[:, 0].real - np.mean(both[:, 0].real, axis=0)
            slope = float(means[:, 0] @ means[:, 1]) / float(means[:, 1] @ means[:, 1])
            rows.append(both[:, 1:, 0] - slope * both[:, 1:, 1])
        return PeriodSpectra(np.array(rows), kept, None)


@dataclass(frozen=True, eq=False)
class PeriodSpectra:
    """Two-sided Fourier coefficients of the outputs, period by period, referred to the first one's beginning.

    Attributes
    ----------
    values : complex ndarray, shape (n_outputs, n_kept, n_bins) -- from the first line on
    kept : ndarray of int, shape (n_kept,) -- which periods they are of
    per_period : int or None -- samples in a period where lines fold as on a grid, else None
    """

    values: ComplexArray
    kept: IndexArray
    per_period: int | None


def _bridged(values: FloatArray, missing: BoolArray, name: str) -> FloatArray:
    """Return values with single missing samples put in by straight lines."""
    if np.mean(missing) > _MAX_MISSING:
        raise EstimationError(
            f"output {name!r}: {np.mean(missing):.1%} of the samples are missing; where lines fold, a periodic "
            f"response bridges at most {_MAX_MISSING:.0%}. Fit a model instead: identify() leaves them out"
        )
    found = np.array(values)
    found[missing] = np.interp(np.flatnonzero(missing), np.flatnonzero(~missing), values[~missing])
    return found


def _longest_hole(phases: FloatArray) -> float:
    """Return the longest step between places on a circle of 1."""
    if not len(phases):
        return 1.0
    return float(np.max(np.diff(phases, append=phases[0] + 1.0)))


def _harmonics(phases: FloatArray, values: FloatArray, n_lines: int) -> ComplexArray:
    """Return the coefficients of lines 0 .. n_lines that fit values best, at any places of a period.

    Parameters
    ----------
    phases : ndarray, shape (n,) -- places in the period, from 0 to 1
    values : ndarray, shape (n, n_rows)
    n_lines : int -- fewer than half of n

    Notes
    -----
    With columns ``e^(j 2 pi l x)``, l = -n_lines .. n_lines, entry (l, m) of the normal equations is the sum over
    the samples of ``e^(j 2 pi (m - l) x)``: a Toeplitz matrix.
    """
    from scipy.linalg import solve_toeplitz

    turn = np.exp(-2j * np.pi * phases)
    power = np.ones(len(phases), dtype=np.complex128)
    first = np.empty(2 * n_lines + 1, dtype=np.complex128)
    right = np.empty((n_lines + 1, values.shape[1]), dtype=np.complex128)
    for line in range(2 * n_lines + 1):
        first[line] = np.sum(power)
        if line <= n_lines:
            right[line] = power @ values
        power = power * turn
    whole = np.concatenate([np.conj(right[:0:-1]), right])
    return np.asarray(solve_toeplitz((first, np.conj(first)), whole)[n_lines:])


def _level(periods: FloatArray) -> FloatArray:
    """Return the periods without the straight drift that their means show; it would leak into every line."""
    n_periods, n = periods.shape[1:]
    turn = np.arange(n_periods) - 0.5 * (n_periods - 1)
    # Least squares of the periods' means over their number; the ramp runs on inside the periods.
    slope = np.mean(periods, axis=2) @ turn / float(turn @ turn)
    ramp = turn[:, None] + (np.arange(n) - 0.5 * (n - 1)) / n
    return np.asarray(periods - slope[:, None, None] * ramp)


def excited_numbers(source: PeriodicInput, excited_hz: FloatArray | None, line_period_s: float) -> IndexArray:
    """Return the numbers of lines given in Hz, or of those that stand out of the input."""
    top = (source.per_period - 1) // 2
    if excited_hz is None:
        size = np.abs(np.mean(source.coefficients(np.arange(1, top + 1), line_period_s), axis=0))
        numbers = 1 + np.flatnonzero(size > _EXCITED * np.max(size))
    else:
        exact = finite_row("excited_hz [Hz]", excited_hz) * line_period_s
        numbers = np.unique(np.round(exact).astype(np.intp))
        if np.any(np.abs(exact - np.round(exact)) > 1e-3) or np.any((numbers < 1) | (numbers > top)):
            raise EstimationError(
                f"excited_hz: the lines must be multiples of {1.0 / line_period_s:.6g} Hz, from that to below "
                f"{top / line_period_s:.6g} Hz, half the rate of the input"
            )
    if not len(numbers) or not np.any(source.coefficients(numbers, line_period_s)):
        raise EstimationError(
            f"input {source.signal.name!r} excites no line, no multiple of {1.0 / line_period_s:.6g} Hz; expected an "
            "input that moves, and the period and the lines of its excitation"
        )
    return np.asarray(numbers)


@dataclass(frozen=True, eq=False)
class ExcitedLines:
    """The strongest excited line of every bin, and what else falls there."""

    numbers: IndexArray
    bins: IndexArray
    sign: IndexArray  # -1 where the bin holds the conjugate
    every: IndexArray  # all bins onto which something excited falls
    is_shared: BoolArray  # whether several excited lines fall onto the bin
    omegas: FloatArray

    @staticmethod
    def of(
        source: PeriodicInput,
        numbers: IndexArray,
        per_period: int | None,
        line_period_s: float,
        exposure_s: float,
    ) -> ExcitedLines:
        """Choose the lines that the outputs show, with ``per_period`` samples in a period or without a grid."""
        n_bins = 4 * int(numbers[-1]) if per_period is None else per_period  # off a grid nothing folds
        # Where a line falls when the outputs sample it, and on which side.
        place = numbers % n_bins
        sign = np.where(place <= n_bins // 2, 1, -1)
        bins = np.where(sign > 0, place, n_bins - place)
        omegas = angular(numbers, line_period_s)
        size = np.abs(np.mean(source.coefficients(numbers, line_period_s), axis=0))
        size = size * np.abs(exposure_gain(omegas, exposure_s))
        usable = (bins > 0) & (2 * bins < n_bins) & (size > 0.0)
        # Of several lines in one bin the strongest is reported; the others become its images.
        best: dict[int, int] = {}
        for k in np.flatnonzero(usable):
            if bins[k] not in best or size[k] > size[best[int(bins[k])]]:
                best[int(bins[k])] = int(k)
        chosen = np.array(sorted(best.values()), dtype=np.intp)
        if not len(chosen):
            raise EstimationError("no excited line falls on a line of the outputs; sample them faster")
        return ExcitedLines(
            numbers[chosen],
            bins[chosen],
            sign[chosen],
            np.unique(bins[bins > 0]),
            np.asarray(np.bincount(bins)[bins[chosen]] > 1),
            np.asarray(omegas[chosen], dtype=np.float64),
        )

    def input_of(self, source: PeriodicInput, exposure_s: float, line_period_s: float) -> ComplexArray:
        """Return the input at the lines, exposed, shape (n_periods, n_lines)."""
        gain = exposure_gain(self.omegas, exposure_s)
        return np.asarray(source.coefficients(self.numbers, line_period_s) * gain)

    def folding(
        self, source: PeriodicInput, sampled: list[Any], n_bins: int, line_period_s: float, exposure_s: float
    ) -> Folding:
        """Return images and tails of every line."""
        highest = _IMAGES_ABOVE * max(source.per_period, n_bins)
        turns = np.arange(-(highest // n_bins), highest // n_bins + 1)
        # Line numbers in the same bin, of the sign under which the line is reported.
        others = self.numbers[:, None] + turns[None, :] * n_bins
        omegas = angular(others, line_period_s)
        own = self.input_of(source, exposure_s, line_period_s)[0]
        strength = source.coefficients(others.ravel(), line_period_s).reshape(others.shape)
        # w_i of (F.4).
        weights = strength * exposure_gain(omegas, exposure_s) / own[:, None]
        # Structures fall like 1/omega^2 above their modes: what counts of an image is its weight times that.
        importance = np.abs(weights) * np.minimum(
            1.0, (self.omegas[:, None] / np.maximum(np.abs(omegas), 1e-300)) ** 2
        )
        importance[:, len(turns) // 2] = 0.0
        importance[others == 0] = 0.0
        kept = min(_MAX_IMAGES, int(np.max(np.count_nonzero(importance > _IMAGE_FLOOR, axis=1), initial=0)))
        order = np.argsort(-importance, axis=1)[:, :kept]
        image_omegas = np.take_along_axis(omegas, order, axis=1)
        image_weights = np.take_along_axis(weights, order, axis=1)
        absent = np.take_along_axis(importance, order, axis=1) <= _IMAGE_FLOOR
        image_omegas = np.where(absent, self.omegas[:, None], image_omegas)
        image_weights = np.where(absent, 0.0, image_weights)
        tails = np.empty((len(self.numbers), len(TAIL_POWERS)), dtype=np.complex128)
        for column, power in enumerate(TAIL_POWERS):
            total = sampled[column][self.bins - 1]
            total = np.where(self.sign > 0, total, np.conj(total)) / own
            # Tail = everything that the sampled integral holds, less the line itself and the listed images.
            counted = (1j * self.omegas) ** -power
            counted = counted + np.sum(image_weights * (1j * image_omegas) ** float(-power), axis=1)
            tails[:, column] = total - counted
        return Folding(image_omegas, image_weights, tails)


def moving_mean(values: AnyArray, width: int) -> AnyArray:
    """Return the mean over ``width`` neighbouring lines, fewer of them on one side at the ends."""
    n = len(values)
    total = np.concatenate([np.zeros((1, *values.shape[1:]), dtype=values.dtype), np.cumsum(values, axis=0)])
    first = np.clip(np.arange(n) - width // 2, 0, n - width)
    return np.asarray((total[first + width] - total[first]) / width)


def mean_of_neighbours(values: FloatArray, width: int) -> FloatArray:
    """Return the mean over ``width`` neighbouring lines without the line itself.

    Notes
    -----
    Noise over a level with the line's own noise in it is 1 on average; anything else over that level is more than 1,
    because a level that happens to be low weighs more. An F test of both accuses too often: the more lines, the more.
    """
    window = min(width + 1, len(values))
    if window < 2:
        return values
    return np.asarray((window * moving_mean(values, window) - values) / (window - 1))
