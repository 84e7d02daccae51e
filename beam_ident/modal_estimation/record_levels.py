"""What records bring of their own to a fit of modes: the level of their noise, and the gaps of their inputs.

Several records are not equally noisy: every output weighs in each by its noise there, and slow noise less where it
is loud.  The levels are those of the residuals of a fit; levels and fit take turns until neither moves.  What is not
known of an input in its gaps moves the estimates like noise; where it moves them too far, the modes begin anew
(``modal.restarts``).  Stamps may scatter, in each record by themselves.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.special import chdtri as chi_squared_isf

from beam_ident.arrays import FloatArray
from beam_ident.data.gaps import POOR_BRIDGE, InputGap, describe_gaps
from beam_ident.data.prior import Prior
from beam_ident.data.records import TimeRecord
from beam_ident.modal.condensed_columns import residuals_of
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.identification_result import OutputFit
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.restarts import Restarts, bridge_amplitudes, bridge_effects
from beam_ident.modal.stacked_regression import StackedRegression
from beam_ident.modal_estimation.input_disturbance import Observations
from beam_ident.modal_estimation.variable_projection import designs, fit_modes
from beam_ident.noise.continuous_noise import ContinuousNoise, ContinuousWhitening, continuous_noise
from beam_ident.noise.outliers import outliers, spoiling
from beam_ident.noise.scores import are_rounding
from beam_ident.sensing.stamp_jitter import StampJitter

_SLOW = 0.5  # of the residuals' power: where whitening leaves less, equal weights hide modes
_MOST_FROM_BRIDGES = 0.05  # of the variance of a pole or of the clock
_NO_ERROR = 1e-9  # of an output's noise: an error of a bridge is never taken to be less
_SURPRISE = float(chi_squared_isf(1, 1e-3))  # mean square over what is expected: one restart in a thousand
_TURNS = 6
_SETTLED = 0.02  # standard deviations that a turn may still move a pole

RegressionT = TypeVar("RegressionT", ModalRegression, StackedRegression)


def weigh_records(
    regression: ModalRegression, fit: ModalFit, latency: Prior, clock_rate: Prior
) -> tuple[ModalRegression, ModalFit]:
    """Return the regression and the fit in which every record weighs by its noise; of one record as they are.

    Parameters
    ----------
    regression : ModalRegression -- with all records alike
    fit : ModalFit -- of it
    latency, clock_rate : Prior
    """
    if len(regression.inputs) == 1:
        return regression, fit
    weighed = regression
    for _ in range(_TURNS):
        weighed = regression.weighed(record_levels(weighed, fit))
        following = fit_modes(weighed, fit.omegas, fit.zetas, fit.clock, latency, clock_rate)
        n = 2 * len(fit.omegas)
        moved = np.concatenate([np.log(following.omegas / fit.omegas), following.zetas - fit.zetas])
        reach = np.sqrt(np.maximum(np.diag(following.covariance)[:n], 1e-300))
        fit = following
        if not np.any(np.abs(moved) > _SETTLED * reach):
            break
    return weighed, fit


def without_outliers(records: Sequence[TimeRecord], outputs: Sequence[OutputFit]) -> list[TimeRecord] | None:
    """Return records in which the gross outliers of a fit are not seen; None where there are too few to report.

    Parameters
    ----------
    records : sequence of TimeRecord -- that were fitted, outputs on the stamps that they have there
    outputs : sequence of OutputFit -- what the fit leaves
    """
    found, cleaned = False, list(records)
    for output in outputs:
        with_it = [k for k, one in enumerate(records) if output.name in one.output_names]
        for k, own in zip(with_it, output.records, strict=True):
            far = outliers(own.residuals / own.spread)
            if not spoiling(own.residuals / own.spread, far) or are_rounding(own.measured, own.residuals):
                continue
            found = True
            signals = tuple(
                dataclasses.replace(
                    signal, values=np.where(np.isin(signal.times_s, own.times_s[far]), np.nan, signal.values)
                )
                if signal.name == output.name
                else signal
                for signal in cleaned[k].outputs
            )
            cleaned[k] = dataclasses.replace(cleaned[k], outputs=signals)
    return cleaned if found else None


def stamp_jitters(regression: ModalRegression, fit: ModalFit) -> tuple[StampJitter, ...]:
    """Return how the stamps of every record scatter, as the residuals of a fit with equal weights show."""
    speeds = output_speeds(regression, fit.omegas, fit.zetas, fit.clock, fit.coefficients)
    found = []
    for record in range(len(regression.inputs)):
        observations = Observations.of_record(regression, record, fit.clock.latency)
        left, moving = observations.table(fit.residuals), observations.table(speeds)
        found.append(StampJitter.of(left, moving, observations.rows >= 0))
    return tuple(found)


def output_speeds(
    regression: ModalRegression,
    omegas: FloatArray,
    zetas: FloatArray,
    clock: ClockState,
    coefficients: Sequence[FloatArray],
) -> list[FloatArray]:
    """Return how fast every output moves at its stamps, as a model says [unit/s]."""
    speeds: list[list[FloatArray]] = [[] for _ in coefficients]
    for piece in regression.pieces:
        blocks = piece.blocks(omegas, zetas, clock, gradients=True)
        for parts, block, found in zip(speeds, piece.block_of, coefficients, strict=True):
            by_time = blocks[block].by_time
            assert by_time is not None
            parts.append(by_time @ found)
    return [np.concatenate(parts) for parts in speeds]


def unturned(regression: ModalRegression | StackedRegression, fit: ModalFit) -> ModalFit:
    """Return a fit of a regression whose rows may be turned, with residuals and noise as they are before that."""
    if not regression.turns:
        return fit
    left = residuals_of(regression.unturned, fit.omegas, fit.zetas, fit.clock, fit.coefficients)
    powers = np.array([float(np.mean(np.square(own))) for own in left])
    return dataclasses.replace(fit, residuals=tuple(left), sigmas=np.sqrt(powers))


def unweighed(regression: ModalRegression, fit: ModalFit) -> ModalFit:
    """Return a fit of a weighed or turned regression with residuals and noise in the units of the outputs."""
    if regression.turns:
        return unturned(regression, fit)
    levels = [regression.row_levels(j) for j in range(regression.n_outputs)]
    return dataclasses.replace(
        fit,
        residuals=tuple(left * own for left, own in zip(fit.residuals, levels, strict=True)),
        sigmas=fit.sigmas * np.array([math.sqrt(float(np.mean(np.square(own)))) for own in levels]),
    )


def record_levels(regression: ModalRegression, fit: ModalFit) -> list[FloatArray]:
    """Return the level of every output's noise in each of its records, their weighted geometric mean one.

    Parameters
    ----------
    regression : ModalRegression -- weighed or not
    fit : ModalFit -- of it

    Notes
    -----
    The parameters are paid by the records that have them; those that all share, in proportion to samples.
    """
    n_own = regression.n_nuisance(len(fit.omegas))
    n_common = regression.n_shared(len(fit.omegas)) + 2.0 * len(fit.omegas) / regression.n_outputs
    result = []
    for j, residuals in enumerate(fit.residuals):
        left = residuals * regression.row_levels(j)
        floor = 1e-12 * float(np.max(np.abs(regression.values[j] * regression.row_levels(j)))) + 1e-300
        logs, sizes = [], []
        for _, part in regression.segments[j]:
            size = part.stop - part.start
            n_free = max(size - n_own - n_common * size / len(left), 1.0)
            logs.append(math.log(max(float(np.linalg.norm(left[part])) / math.sqrt(n_free), floor)))
            sizes.append(size)
        mean = float(np.average(logs, weights=sizes)) if len(logs) > 1 else logs[0]
        result.append(np.exp(np.array(logs) - mean))
    return result


@dataclass(frozen=True, eq=False)
class SlowNoiseWeights:
    """Weights of the search by the slow noise of every output, as a model with some of the modes leaves it.

    A drift, or a camera that sways, is loudest where no mode is, and with equal weights it hides the modes that stand
    out of it elsewhere.  Ornstein-Uhlenbeck noise beside white noise has no resonance, so that it takes no mode for
    noise as an autoregression would, whose order rises with what a model lacks.

    Attributes
    ----------
    processes : list of list of ContinuousNoise or None -- of every output in each of its segments; None is white
    levels : list of ndarray -- of the innovations in each segment, their weighted geometric mean one
    is_loud : bool -- whether some output would be whitened to less than half of its power
    """

    processes: list[list[ContinuousNoise | None]]
    levels: list[FloatArray]
    is_loud: bool

    @staticmethod
    def of(regression: ModalRegression | StackedRegression, fit: ModalFit) -> SlowNoiseWeights:
        """Return those of a fit with residuals as measured."""
        processes, levels, is_loud = [], [], False
        for residuals, times, segments in zip(
            fit.residuals, regression.times, regression.segments, strict=True
        ):
            found, logs, sizes, before = [], [], [], []
            for _, part in segments:
                left, stamps = residuals[part], times[part]
                process = continuous_noise(left, stamps, max_order=1)
                powers = [
                    float(np.mean(np.square(own))) for own in (left, _slow_whitened(process, stamps, left))
                ]
                found.append(process)
                before.append(np.log(max(powers[0], 1e-300)))
                logs.append(np.log(max(powers[1], 1e-300)))
                sizes.append(len(left))
            mean = np.average(logs, weights=sizes)
            is_loud |= bool(mean - np.average(before, weights=sizes) < np.log(_SLOW))
            processes.append(found)
            levels.append(np.exp(0.5 * (np.array(logs) - mean)))
        return SlowNoiseWeights(processes, levels, is_loud)

    def turned(self, regression: RegressionT) -> RegressionT:
        """Return the regression of the same outputs, at these or at fewer stamps, with rows that are white."""
        return regression.turned([self._turn(regression, j) for j in range(len(regression.values))])

    def _turn(
        self, regression: ModalRegression | StackedRegression, output: int
    ) -> Callable[[FloatArray], FloatArray]:
        """Return the map of an output's rows, of determinant one: costs before and after compare."""
        times = regression.times[output]
        parts = [part for _, part in regression.segments[output]]

        def turn(columns: FloatArray) -> FloatArray:
            owned = zip(parts, self.processes[output], self.levels[output], strict=True)
            rows = [_slow_whitened(own, times[part], columns[part]) / level for part, own, level in owned]
            return np.concatenate(rows)

        return turn


def _slow_whitened(process: ContinuousNoise | None, times_s: FloatArray, columns: FloatArray) -> FloatArray:
    return columns if process is None else ContinuousWhitening(process, times_s).apply(columns)


@dataclass(frozen=True, eq=False)
class BridgeUncertainty:
    """What the bridges over gaps of the inputs do to a fit.

    Attributes
    ----------
    restarts : Restarts -- the gaps after which the modes must begin anew
    covariance : ndarray -- what all other bridges add to the covariance of the parameters
    """

    restarts: Restarts
    covariance: FloatArray

    @staticmethod
    def of(
        regression: ModalRegression,
        fit: ModalFit,
        latency: Prior,
        clock_rate: Prior,
        most: float = _MOST_FROM_BRIDGES,
    ) -> BridgeUncertainty:
        """Judge the bridges by a fit of a regression.

        Parameters
        ----------
        regression : ModalRegression
        fit : ModalFit -- of it
        latency, clock_rate : Prior
        most : float -- share of the variance of a pole or of the clock that bridges may add

        Notes
        -----
        With the derivatives D of the model, the noise's variances s and the covariance C of the parameters, an
        error d of the outputs moves the estimate by ``C D^T d / s``. Every bridge has errors of its kind at places
        where the input is known; their mean square is what it adds to the variance. The bridges that add most to
        some pole or clock are given up, until all others together add no more than ``most``.
        """
        n_shared = regression.n_shared_fixed + len(fit.omegas)
        kept = regression.restarts
        asked = [
            (index, gap)
            for index, drive in enumerate(regression.drives)
            for gap in drive.gaps
            if gap not in kept.gaps[index] or gap in kept.rigid[index]
        ]
        scores = [np.zeros((len(fit.covariance), len(gap.errors))) for _, gap in asked]
        for piece in regression.pieces if asked else ():
            instants = piece.instants(fit.clock)
            place = fit.n_theta
            for j, design in enumerate(designs(piece, fit, latency, clock_rate)):
                found, weighed = fit.coefficients[j], design.T / fit.sigmas[j] ** 2
                own = np.concatenate([np.arange(fit.n_theta), np.arange(place, place + len(found))])
                place += len(found)
                for score, (index, gap) in zip(scores, asked, strict=True):
                    for part in (part for record, part in piece.segments[j] if record == index):
                        effects = bridge_effects(
                            gap,
                            regression.structure,
                            fit.omegas,
                            fit.zetas,
                            found[:n_shared],
                            instants[j][part],
                            with_direct=gap not in kept.rigid[index],
                        )
                        score[own] += weighed[:, part] @ effects.T
        scale = np.sqrt(np.maximum(np.diag(fit.covariance)[: fit.n_theta], 1e-300))
        judged = []
        for score, (index, gap) in zip(scores, asked, strict=True):
            moved = fit.covariance @ score / math.sqrt(len(gap.errors))
            share = float(np.max(np.sum(np.square(moved[: fit.n_theta]), axis=1) / scale**2, initial=0.0))
            judged.append((share, index, gap, moved))
        judged.sort(key=lambda item: item[0])
        n_kept = int(np.searchsorted(np.cumsum([item[0] for item in judged]), most))
        given_up, rigid = [set(own) for own in kept.gaps], [set(own) for own in kept.rigid]
        for _, index, gap, _ in judged[n_kept:]:
            given_up[index].add(gap)
            rigid[index].discard(gap)
        added = np.zeros_like(fit.covariance)
        for _, _, _, moved in judged[:n_kept]:
            added += moved @ moved.T
        gaps = tuple(tuple(sorted(own, key=lambda gap: gap.start_s)) for own in given_up)
        restarts = Restarts(gaps, kept.n_drifts, tuple(map(frozenset, rigid)), fit.clock.latency)
        return BridgeUncertainty(restarts, added)


def restart_priors(regression: ModalRegression, fit: ModalFit) -> list[tuple[int, float]]:
    """Return what is known of the columns that begin after gaps: their place among the parameters, and its size.

    The bridge is in the regression's input still, so that these columns hold its errors alone, and errors of its
    kind are known.  With them a restart is a bridge that counts as far as it is to be believed: not at all where it
    is poor, and no further than what the fit, without such knowledge, found there itself.
    """
    n, structure = len(fit.omegas), regression.structure
    poor = {
        gap
        for drive in regression.drives
        for gap in drive.gaps
        if not gap.sigma < POOR_BRIDGE * float(np.std(drive.values))
    }
    # Of every restart and kind of column: its place at every output, and the size of the bridge's errors there.
    known: dict[tuple[InputGap, int], list[tuple[int, float]]] = {}
    first = fit.n_theta
    for j, found in enumerate(fit.coefficients):
        residues = found[regression.n_shared_fixed : regression.n_shared_fixed + n]
        least = _NO_ERROR * float(fit.sigmas[j])
        for gap, place, is_modal in regression.restart_places(n, j):
            if gap in poor:
                continue
            modal, drifts = bridge_amplitudes(gap, structure, fit.omegas, fit.zetas)
            sizes = [(abs(float(found[0])) * float(np.linalg.norm(own)), 1) for own in drifts.T]
            for residue, own in zip(residues, modal.T, strict=True) if is_modal else ():
                sizes.append((abs(float(residue)) * float(np.linalg.norm(own)) / math.sqrt(2.0), 2))
            column = first + place
            for kind, (size, width) in enumerate(sizes):
                own_size = max(size / math.sqrt(len(gap.errors)), least)
                known.setdefault((gap, kind), []).extend((column + k, own_size) for k in range(width))
                column += width
        first += len(found)
    amplitudes = np.concatenate([np.zeros(fit.n_theta), *fit.coefficients])
    variances = np.maximum(np.diag(fit.covariance), 0.0)
    priors = []
    for columns in known.values():
        places = np.array([place for place, _ in columns])
        expected = np.square([size for _, size in columns]) + variances[places]
        # All outputs see the same errors: together they are one random number, or two of a free motion.
        surprise = float(np.mean(np.square(amplitudes[places]) / expected))
        worse = math.sqrt(surprise) if surprise > _SURPRISE else 1.0
        priors += [(place, worse * size) for place, size in columns]
    return priors


def gap_sentences(regression: ModalRegression) -> list[str]:
    """Return what was done about the gaps of every record's input."""
    pairs = zip(regression.inputs, regression.restarts.gaps, regression.restarts.rigid, strict=True)
    return [
        describe_gaps(drive.name, drive.gaps, drive.unit, [gap for gap in anew if gap not in rigid], rigid)
        for drives, anew, rigid in pairs
        for drive in drives
        if drive.gaps
    ]
