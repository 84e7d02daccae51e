"""What noise on the inputs does to the score of a fit at the inputs as they were measured, by draws of it.

Such noise is in the derivatives as well as in the residuals, so that their product has a mean at the true parameters:
the bias of errors in variables.  It looks like information, and it lets the score scatter.  All three are
those of many quadratic forms in noise that has passed low-pass, model and exposures; seeded draws know them as
exactly as the model itself does, whatever a filter takes the noise for.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.records import InputSignal
from beam_ident.modal.block_rows import ColumnBlock
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal_estimation.input_disturbance import DisturbanceFilter, Observations
from beam_ident.modal_estimation.variable_projection import MIN_DAMPING
from beam_ident.noise.input_noise import Smoothing
from beam_ident.sensing.stamp_jitter import StampJitter

_DRAWS = 16  # of records with thousands of samples
_DRAWN = 200_000  # samples of an output over all draws: those of a long record need less repetition
_AT_ONCE = 3_000_000  # numbers that draws may hold together


@dataclass(frozen=True, eq=False)
class FitPoint:
    """Parameters, in the order of ``ModalFit.covariance``."""

    omegas: FloatArray
    zetas: FloatArray
    clock: ClockState
    coefficients: tuple[FloatArray, ...]

    def begins(self, clock_is_free: tuple[bool, bool]) -> list[int]:
        """Return where the linear parameters of every output begin, and behind them the number of all parameters."""
        n_common = 2 * len(self.omegas) + sum(clock_is_free)
        return list(accumulate(map(len, self.coefficients), initial=n_common))


@dataclass(frozen=True, eq=False)
class Stride:
    """A step that is no longer than half the width of a resonance, and half as far whenever one takes the last back.

    So far the model goes along its derivatives; and a drawn score has no cost that could tell a step too long.
    """

    change: FloatArray
    share: float = 1.0

    def following(self, change: FloatArray, point: FitPoint) -> Stride:
        """Return the step after this one, of the change that the score asks for at a point."""
        n = len(point.omegas)
        widths = np.tile(np.maximum(point.zetas, MIN_DAMPING), 2)
        farthest = float(np.max(np.abs(change[: 2 * n]) / widths, initial=0.0))
        takes_back = float(change[: 2 * n] @ self.change[: 2 * n]) < 0.0
        share = 0.5 * self.share if takes_back else min(2.0 * self.share, 1.0)
        return Stride(change * share / max(2.0 * farthest, 1.0), share)


@dataclass(frozen=True, eq=False)
class NoiseScore:
    """What noise in derivatives and residuals adds to score and information, (I.15) and (I.18).

    Attributes
    ----------
    mean : ndarray, shape (n_parameters,) -- of the score
    information : ndarray, shape (n_parameters, n_parameters) -- N, that it only feigns
    scatter : ndarray, shape (n_parameters, n_parameters) -- C, the covariance of what it adds to the score
    mean_error : ndarray, shape (n_parameters, n_parameters) -- covariance by which so few draws miss the mean
    """

    mean: FloatArray
    information: FloatArray
    scatter: FloatArray
    mean_error: FloatArray

    def of_longer(self, grown: float) -> NoiseScore:
        """Return that of a record so many times as long: noise does not depend on the input."""
        return NoiseScore(
            grown * self.mean, grown * self.information, grown * self.scatter, grown**2 * self.mean_error
        )


@dataclass(frozen=True, eq=False)
class _Draw:
    """One draw: smoothed noise of every record's input; of outputs' rows and stamps of unit variance."""

    inputs: list[FloatArray]
    own: list[FloatArray]
    late: list[FloatArray]


class NoiseDraws:
    """Draws of the noise of inputs, outputs and stamps, the same ones at every point.

    Parameters
    ----------
    regression : ModalRegression -- of the measured inputs, with their ``sigma``
    smoothing : Smoothing -- low-pass that the inputs have passed
    on_inputs : callable -- returns the regression on other, smoothed samples of every input
    n_shared : int -- of an output's linear parameters, those that pass the input
    clock_is_free : tuple of bool -- latency, rate
    """

    def __init__(
        self,
        regression: ModalRegression,
        smoothing: Smoothing,
        on_inputs: Callable[[Sequence[FloatArray]], ModalRegression],
        n_shared: int,
        clock_is_free: tuple[bool, bool],
    ) -> None:
        self._on_inputs, self._n_shared, self._clock_is_free = on_inputs, n_shared, clock_is_free
        longest = max(map(len, regression.values))
        self._observations = [
            Observations.of_record(regression, k, 0.0) for k in range(len(regression.drives))
        ]
        rng = np.random.default_rng(0)

        def smoothed(drive: InputSignal) -> FloatArray:
            noise = drive.sigma * rng.standard_normal(len(drive.values))
            return smoothing.of(InputSignal(drive.name, drive.unit, drive.times_s, noise, drive.hold)).values

        self._draws = [
            _Draw(
                [smoothed(drive) for drive in regression.drives],
                [rng.standard_normal(len(values)) for values in regression.values],
                [rng.standard_normal(len(seen.times)) for seen in self._observations],
            )
            for _ in range(min(_DRAWS, math.ceil(_DRAWN / longest)))
        ]

    def score(
        self,
        point: FitPoint,
        spreads: Sequence[FloatArray],
        filters: Sequence[DisturbanceFilter],
        jitters: Sequence[StampJitter],
    ) -> NoiseScore:
        """Return what the noise does at a point.

        Parameters
        ----------
        point : FitPoint
        spreads : sequence of ndarray -- standard deviation of every output's own noise at every row
        filters : sequence of DisturbanceFilter -- of every record
        jitters : sequence of StampJitter -- of every record, or none
        """
        scores, information = [], 0.0
        n = len(self._draws)
        n_columns = point.begins(self._clock_is_free)[-1] + 1
        at_once = max(_AT_ONCE // (n_columns * sum(map(len, spreads))), 1)
        for first in range(0, n, at_once):
            drawn = [
                self._rows(draw, point, spreads, jitters) for draw in self._draws[first : first + at_once]
            ]
            # Several draws in one pass of the filter.
            together = [np.concatenate(own, axis=1) for own in zip(*drawn, strict=True)]
            for own in filters:
                own.whiten(together)
            white = np.concatenate(together).reshape(sum(map(len, together)), len(drawn), -1)
            for rows in np.moveaxis(white, 1, 0):
                design, left = rows[:, :-1], rows[:, -1]
                scores.append(design.T @ left)
                information += design.T @ design / n
        mean = np.mean(scores, axis=0)
        off = np.array(scores) - mean
        scatter = off.T @ off / max(n - 1, 1)
        return NoiseScore(mean, np.asarray(information), scatter, scatter / n)

    def _rows(
        self, draw: _Draw, point: FitPoint, spreads: Sequence[FloatArray], jitters: Sequence[StampJitter]
    ) -> list[FloatArray]:
        """Return derivatives by all parameters at the noise, and r = e - H nu of (I.12) beside them, of every output.

        The noise comes through poles, gains and residues alone: offset, ramp and free motion do not pass the input.
        """
        regression = self._on_inputs(draw.inputs)
        blocks = regression.blocks(point.omegas, point.zetas, point.clock, gradients=True)
        *begins, total = point.begins(self._clock_is_free)
        rows = []
        of_outputs = zip(regression.block_of, point.coefficients, begins, strict=True)
        for output, (number, found, first) in enumerate(of_outputs):
            block, shared = blocks[number], found[: self._n_shared]
            through = _padded(shared, block)
            full = np.zeros((len(block.matrix), total + 1))
            full[:, : begins[0]] = block.slopes(through, *self._clock_is_free)
            full[:, first : first + len(shared)] = block.matrix[:, : len(shared)]
            full[:, -1] = spreads[output] * draw.own[output] - block.matrix @ through
            rows.append(full)
        # What the stamps' jitter does to the outputs, (I.26).
        for jitter, seen, late in zip(jitters, self._observations, draw.late, strict=False):
            for output, places in enumerate(seen.rows.T):
                is_seen = places >= 0
                moved = jitter.sd_s * late[:, None] * jitter.speeds
                rows[output][places[is_seen], -1] += moved[is_seen, output]
        return rows


def _padded(shared: FloatArray, block: ColumnBlock) -> FloatArray:
    """Return linear parameters of a block's columns of which only the first are not zero."""
    result = np.zeros(block.matrix.shape[1])
    result[: len(shared)] = shared
    return result
