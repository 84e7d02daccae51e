"""The last step of a fit: every sample weighed by the noise as it is.

Least squares with equal weights is unbiased while the input is known and the outputs'
noise is independent of it, of any colour, but it is neither the most precise
estimate nor are its plain intervals right.  The residuals of such a fit show the noise:

- with a known input, the colour of every output's residuals in every record (an autoregression or, at stamps of
  any spacing, a process in continuous time) whitens residuals and derivatives alike (generalised least squares);
  outliers are left out, and what is left weighs by Student's t (``noise.noise_model``); what outputs share of it
  weighs by the inverse of their correlation (``noise.shared_noise``);
- with noise on the input, a Kalman filter does (``modal_estimation.input_disturbance``).  The noise is in the
  derivatives as well, so that the score has a mean at the true parameters, the bias of errors in variables; drawn
  noise tells that mean (``modal_estimation.noise_draws``), and it is taken away (Soderstrom, Errors-in-Variables
  Methods, 2018).

Gauss-Newton steps on all parameters, the linear ones included, end where both hold.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.data.prior import Prior
from beam_ident.data.records import TimeRecord
from beam_ident.errors import IdentificationError
from beam_ident.modal.block_rows import ColumnBlock
from beam_ident.modal.condensed_columns import residuals_of
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.stacked_regression import StackedRegression
from beam_ident.modal_estimation.input_disturbance import (
    DisturbanceFilter,
    InputDisturbance,
    Observations,
    disturbances_by_record,
)
from beam_ident.modal_estimation.noise_draws import FitPoint, NoiseDraws, NoiseScore, Stride
from beam_ident.modal_estimation.record_levels import output_speeds
from beam_ident.modal_estimation.variable_projection import MAX_DAMPING, MIN_DAMPING
from beam_ident.noise.autoregression import ColouredRows, ScoreCovariance, autoregression
from beam_ident.noise.input_noise import Smoothing
from beam_ident.noise.noise_model import NoisePass, RecordNoise, Whitening
from beam_ident.noise.scores import are_rounding
from beam_ident.noise.shared_noise import SharedNoise
from beam_ident.numerics.linear_least_squares import LinearSolution, StackedTriangle
from beam_ident.sensing.stamp_jitter import StampJitter

_MAX_STEPS = 15
_MAX_SLOW_STEPS = 40  # of weights by the tails, and by noise of which the score itself is drawn
_LOOKS = 2  # at the noise, once the fit has left what outliers did to its start
_STEP_TOLERANCE = 1e-2  # of a standard deviation, per parameter
_NEAR = 0.5  # the same, from where on the weights of rounded values need no caution
_MAX_STEP = 0.1  # of a natural frequency
_MAX_TRAVEL = 6.0  # standard deviations by which weights alone may move a pole
_MAX_TRAVEL_WITH_INPUT = 200.0  # the same where noise on the input has biased the start
_STRETCH = 12_500  # samples of an output that are drawn for a long record, too few to be long themselves
_MAX_FEIGNED = 0.9  # share of the information on a parameter, beyond which N is no better known than H - N
_LEVEL_TURNS = 3  # of the outputs' own variances and the filter
_MENTIONED = 0.01  # share of an output's noise that the others tell
_MIN_POWER = 0.5  # of innovations, whose variance is one where the noise is as stated
_MIN_VARIANCE = 1e-4  # of the residuals': an output is never taken to be less noisy than this
_MIN_VARIANCE_IN_SEARCH = (
    0.05  # the same while modes are looked for, which a sigma far too large must not hide
)


@dataclass(frozen=True, eq=False)
class _Linearisation:
    """Whitened residuals and derivatives at one point.

    Attributes
    ----------
    design, residuals : ndarray
        D and w of (I.10); of a long record after an orthogonal transformation of both, in few rows.
    innovations : tuple of ndarray -- w of every output, as it is
    whitened : callable
        Returns D and w side by side, of every output, piece by piece, in the columns that it touches.
    """

    design: FloatArray
    residuals: FloatArray
    innovations: tuple[FloatArray, ...]
    whitened: Callable[[], Iterable[Sequence[FloatArray]]]
    filters: tuple[DisturbanceFilter, ...] = ()


class WeightedFit:
    """A fit whose samples are weighed by the noise that its residuals show.

    Parameters
    ----------
    records : sequence of TimeRecord -- none of free decays
    regression : ModalRegression or StackedRegression
        Of these records, with the smoothing where the input is noisy; or of free decays.
    fit : ModalFit -- with equal weights, where to begin
    latency, clock_rate : Prior
    smoothing : Smoothing or None
        Given where the input's ``sigma`` matters.
    priors : sequence of (tuple of int, float, float)
        Sums of parameters, by their places in ``ModalFit.covariance``, and what is known of them: mean and sd.
    jitters : sequence of StampJitter -- of every record, with the smoothing
    """

    def __init__(
        self,
        records: Sequence[TimeRecord],
        regression: ModalRegression | StackedRegression,
        fit: ModalFit,
        latency: Prior,
        clock_rate: Prior,
        smoothing: Smoothing | None = None,
        priors: Sequence[tuple[tuple[int, ...], float, float]] = (),
        jitters: Sequence[StampJitter] = (),
    ) -> None:
        self.priors, self.jitters = priors, tuple(jitters)
        self.records, self.regression, self.fit = list(records), regression, fit
        self.latency, self.clock_rate, self.smoothing = latency, clock_rate, smoothing
        self.n_theta = 2 * len(fit.omegas) + int(latency.is_free) + int(clock_rate.is_free)
        self.n_shared = regression.n_shared_fixed + regression.n_forced * len(fit.omegas)
        self.variances = np.square(fit.sigmas)
        self.freedom = 1.0 - len(fit.covariance) / max(regression.n_samples, 1)
        # Of the outputs' own noise in every record, beside that of the input.
        self.record_variances = np.tile(self.variances, (max(len(self.records), 1), 1))
        if self._scatters:
            self.record_variances = np.array([own.variances for own in self.jitters])
        self.own_shares = self.record_variances / self.variances
        self.noises: list[list[RecordNoise]] = []
        self.shared: SharedNoise | None = None
        self._is_near = False
        if smoothing is None:
            self._take_noise(fit.residuals)

    def _take_noise(self, residuals: Sequence[FloatArray]) -> None:
        """Let every record weigh by the noise that residuals show there; what it was taken for at first stays."""
        known, self.noises, self.levels = self.noises, [], []
        whites = []
        for j, (values, left) in enumerate(zip(self.regression.values, residuals, strict=True)):
            times, segments = self.regression.times[j], self.regression.segments[j]
            if known:
                pairs = zip(known[j], segments, strict=True)
                noises = [own.followed(left[part], self._is_near) for own, (_, part) in pairs]
            elif are_rounding(values, left):
                noises = [RecordNoise(Whitening(np.ones(1), times[part])) for _, part in segments]
            else:
                noises = [RecordNoise.of(values[part], left[part], times[part]) for _, part in segments]
            self.noises.append(noises)
            # sigma_j^2 of (I.10), with the degrees of freedom that all parameters take; records that have a
            # colour or tails each have theirs, all others share the weights that they came with.
            white = [
                own.apply(own.moved(left[part])) for own, (_, part) in zip(noises, segments, strict=True)
            ]
            powers = [
                own.expected * float(np.mean(np.square(seen))) / self.freedom
                for own, seen in zip(noises, white, strict=True)
            ]
            if all(own.is_plain for own in noises):
                powers = [float(np.mean(np.square(left))) / self.freedom] * len(noises)
            self.levels.append(np.sqrt(powers))
            pairs_of = zip(white, self.levels[-1], strict=True)
            whites.append(np.concatenate([seen / max(float(level), 1e-300) for seen, level in pairs_of]))
        if not known:
            self.shared = SharedNoise.of(whites, self._rows_together())

    def _rows_together(self) -> IndexArray:
        """Return the rows of all outputs at every instant, -1 where one has none, an outlier, or a rounded value."""
        records = sorted({record for own in self.regression.segments for record, _ in own})
        every = [Observations.of_record(self.regression, record, 0.0).rows for record in records]
        rows = np.concatenate(every)
        for output, (noises, segments) in enumerate(zip(self.noises, self.regression.segments, strict=False)):
            counts = np.ones(len(self.regression.values[output]), dtype=bool)
            for own, (_, part) in zip(noises, segments, strict=True):
                kept = own.kept if own.tails is None else own.tails.kept
                counts[part] = own.rounding is None and (True if kept is None else kept)
            seen = rows[:, output] >= 0
            seen[seen] = counts[rows[seen, output]]
            rows[~seen, output] = -1
        return rows

    @property
    def is_needed(self) -> bool:
        """Whether the noise is other than what the fit took it for."""
        is_coloured = any(not own.is_plain for noises in self.noises for own in noises)
        is_weighed = self.smoothing is not None or self.shared is not None
        return is_weighed or is_coloured or bool(self.priors)

    @property
    def _mixes(self) -> bool:
        """Whether whitened rows of an output depend on the parameters of others."""
        return self.smoothing is not None or self.shared is not None

    @property
    def _scatters(self) -> bool:
        """Whether the stamps of a record do."""
        return any(own.sd_s > 0.0 for own in self.jitters)

    @property
    def _is_driven_by_noise(self) -> bool:
        """Whether the input's noise matters, and not the stamps' jitter alone."""
        return self.smoothing is not None and math.isfinite(self.smoothing.high_hz)

    @property
    def _has_outliers(self) -> bool:
        return any(own.kept is not None or own.tails is not None for noises in self.noises for own in noises)

    @property
    def _follows(self) -> bool:
        """Whether weights go with the residuals, or outliers may have to be found anew."""
        return self._has_outliers or any(own.follows for noises in self.noises for own in noises)

    @property
    def _is_cautious(self) -> bool:
        return any(own.is_cautious for noises in self.noises for own in noises)

    @property
    def _driven(self) -> ModalRegression:
        """The regression on records with an input, whose noise matters."""
        assert isinstance(self.regression, ModalRegression)
        return self.regression

    def result(self) -> ModalFit:
        """Return the fit weighed by its noise, or the given fit where that does not succeed.

        Notes
        -----
        Residuals that hold unmodelled dynamics have a colour too, but weighing by it moves
        the estimate further than noise can (Hausman, Econometrica 1978): then equal weights
        stay.
        """
        if not self.is_needed:
            return self.fit
        fit = self.fit
        point = FitPoint(fit.omegas, fit.zetas, fit.clock, fit.coefficients)
        travelled = np.zeros(len(fit.covariance))
        reach = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-300))
        farthest = _MAX_TRAVEL if self.smoothing is None else _MAX_TRAVEL_WITH_INPUT
        looks, stride = 0, Stride(np.zeros(len(fit.covariance)))
        noise, moved = None, math.inf
        is_slow = self._follows or self._is_driven_by_noise
        for step in range(1, (_MAX_SLOW_STEPS if is_slow else _MAX_STEPS) + 1):
            # One step of (I.10); with noise on the input D holds the derivatives of (I.15).
            linear = self._linearise(point)
            design, right = self._with_priors(linear, point)
            solution = LinearSolution.of(design)
            change, inverse = solution.coefficients(right), solution.inverse_gram()
            # Where the point moves, the score of the noise changes by no more than its part in the information.
            if moved > 10.0 * _STEP_TOLERANCE:
                noise, moved = self._noise_score(point, linear.filters), 0.0
            if noise is not None:
                inverse = _without_feigned(inverse, noise.information)
                change = inverse @ (design.T @ right - noise.mean)
                stride = stride.following(change, point)
                change = stride.change
            travelled += change
            # Hausman's comparison: under the right noise both estimates differ by no more than both scatter.
            if not np.max(np.abs(travelled / reach)[: self.n_theta], initial=0.0) < farthest:
                return self._with_equal_weights(
                    "weighing by the noise moves the poles further than noise can"
                )
            if not np.max(np.abs(change[: len(fit.omegas)]), initial=0.0) < _MAX_STEP:
                break
            point = self._moved(point, change)
            # D step is the step in units of its standard deviation: |D step|^2 = step^T H step.
            size = float(np.linalg.norm(design @ change)) / math.sqrt(len(change))
            moved += size
            if size < _NEAR and not self._is_near:
                self._is_near = True
                if self._is_cautious:
                    continue
            if size < _STEP_TOLERANCE:
                if self._has_outliers and looks < _LOOKS:
                    # The start was off by what the outliers did to it, which has a colour: look again.
                    looks, self.noises = looks + 1, []
                    self._take_noise(self._residuals(point))
                    continue
                if noise is not None and self._leaves_too_little(linear.innovations):
                    return self._with_equal_weights("the input's noise alone would leave more than is left")
                return self._finished(point, linear, inverse, noise, step)
        return self._with_equal_weights("weighing by the noise did not settle")

    def _leaves_too_little(self, innovations: Sequence[FloatArray]) -> bool:
        """Return whether an output shows less than half of the input's noise that is stated."""
        return any(float(np.mean(np.square(own))) < _MIN_POWER for own in innovations)

    def _with_equal_weights(self, why: str) -> ModalFit:
        """Return the given fit, not converged where the input's noise biases it."""
        reason = f"{why}; weights are equal"
        if self._is_driven_by_noise:
            reason = f"{reason}. Check the sigma that is stated for the input"
        converged = self.fit.converged and not self._is_driven_by_noise
        return dataclasses.replace(self.fit, converged=converged, reason=reason)

    @property
    def _is_long(self) -> bool:
        return len(self.regression.pieces) > 1

    def _linearise(self, point: FitPoint) -> _Linearisation:
        filters: list[DisturbanceFilter] = []
        if self.smoothing is not None:
            residuals = self._residuals(point)
            # The innovations L^-1 r of (I.16) have unit power where the sigma_j^2 are right.
            filters = self._filters(self._disturbances(point))
            white = [r[:, None].copy() for r in residuals]
            for own in filters:
                own.whiten(white)
            self._adjust_variances(white, residuals, _MIN_VARIANCE)
        elif self._follows and self._is_long:
            self._take_noise(self._residuals(point))  # the weights of tails go with the residuals

        def whitened() -> Iterator[list[FloatArray]]:
            return self._whitened(point, filters)

        if self._is_long:
            return self._condensed(whitened, filters)
        (columns,) = whitened()
        stacked = np.zeros((sum(map(len, columns)), len(self.fit.covariance) + 1), order="F")
        first = 0
        for output, own_columns in enumerate(columns):
            rows = slice(first, first + len(own_columns))
            first = rows.stop
            for places in self._touched_slices(output):
                stacked[rows, places[0]] = own_columns[:, places[1]]
        innovations = tuple(own_columns[:, -1] for own_columns in columns)
        return _Linearisation(
            stacked[:, :-1],
            stacked[:, -1],
            innovations,
            lambda: [columns],
            tuple(filters),
        )

    def _condensed(
        self,
        whitened: Callable[[], Iterable[Sequence[FloatArray]]],
        filters: Sequence[DisturbanceFilter],
    ) -> _Linearisation:
        """Return D and w of a long record in as many rows as the outputs touch columns."""
        n_outputs = len(self.fit.coefficients)
        # Rows of outputs that share no parameter but poles and clock need not be turned together.
        n_turned = 1 if self._mixes else n_outputs
        triangles = [StackedTriangle() for _ in range(n_turned)]
        innovations: list[list[FloatArray]] = [[] for _ in range(n_outputs)]
        for columns in whitened():
            for seen, own in zip(innovations, columns, strict=True):
                seen.append(own[:, -1].copy())
            together = columns if n_turned == n_outputs else [np.concatenate(columns)]
            for triangle, rows in zip(triangles, together, strict=True):
                if len(rows):
                    triangle.add(rows)
        design, right = [], []
        for output, triangle in enumerate(triangles):
            spread = np.zeros((len(triangle.rows), len(self.fit.covariance)))
            spread[:, self._touched(output)] = triangle.rows[:, :-1]
            design.append(spread)
            right.append(triangle.rows[:, -1])
        return _Linearisation(
            np.concatenate(design),
            np.concatenate(right),
            tuple(np.concatenate(seen) for seen in innovations),
            whitened,
            tuple(filters),
        )

    def _whitened(self, point: FitPoint, filters: Sequence[DisturbanceFilter]) -> Iterator[list[FloatArray]]:
        """Yield D and w of (I.10) side by side, of every output, piece by piece.

        One pass of a filter whitens both: ``L^-1 dM/deta (a + nu)`` and ``L^-1 r``.

        Parameters
        ----------
        point : FitPoint
        filters : sequence of DisturbanceFilter -- of every record, where the input's noise matters
        """
        passes: dict[tuple[int, int], NoisePass] = {}
        states: dict[int, FloatArray] = {}
        pieces: Sequence[ModalRegression | StackedRegression] = self.regression.pieces
        for piece in pieces:
            blocks = piece.blocks(point.omegas, point.zetas, point.clock, gradients=True)
            columns = []
            for output, (block, found) in enumerate(zip(piece.block_of, point.coefficients, strict=True)):
                rows = self._columns(output, blocks[block], found)
                rows[:, -1] = piece.values[output] - blocks[block].matrix @ found
                columns.append(rows)
            if not filters:
                if self._follows and not self._is_long:
                    # The weights of tails go with the residuals.
                    self._take_noise([rows[:, -1].copy() for rows in columns])
                columns = [self._filtered(piece, output, rows, passes) for output, rows in enumerate(columns)]
                if self.shared is not None:
                    columns = self.shared.unshared(columns, piece.places)
            elif isinstance(piece, ModalRegression) and piece.record is not None:
                # The filter's state goes on from piece to piece.
                own = filters[piece.record]
                states[piece.record] = own.whiten(columns, piece.places, states.get(piece.record))
            else:
                for own in filters:
                    own.whiten(columns)
            yield columns

    def _residuals(self, point: FitPoint) -> tuple[FloatArray, ...]:
        """Return the residuals against the measured input, of every output."""
        return tuple(
            residuals_of(self.regression, point.omegas, point.zetas, point.clock, point.coefficients)
        )

    def _touched_slices(self, output: int) -> list[tuple[slice, slice]]:
        """Return which parameters an output's whitened rows depend on, and the columns that hold them."""
        sizes, n = [len(found) for found in self.fit.coefficients], self.n_theta
        if self._mixes:
            both = slice(0, n + sum(sizes) + 1)
            return [(both, both)]
        first, own = n + sum(sizes[:output]), sizes[output]
        residual = slice(n + sum(sizes), n + sum(sizes) + 1), slice(n + own, n + own + 1)
        return [
            (slice(0, n), slice(0, n)),
            (slice(first, first + own), slice(n, n + own)),
            residual,
        ]

    def _touched(self, output: int) -> IndexArray:
        """Return which parameters an output's whitened rows depend on."""
        slices = [here for here, _ in self._touched_slices(output)]
        return np.concatenate([np.arange(own.start, own.stop) for own in slices])[:-1]

    def _columns(self, output: int, block: ColumnBlock, found: FloatArray) -> FloatArray:
        """Return the derivatives of an output by the parameters that it touches, and room for one column more."""
        sizes = [len(own) for own in self.fit.coefficients]
        first, total = self.n_theta, self.n_theta + sizes[output]
        if self._mixes:
            first, total = first + sum(sizes[:output]), self.n_theta + sum(sizes)
        full = np.zeros((len(block.matrix), total + 1), order="F")
        full[:, : self.n_theta] = block.slopes(found, self.latency.is_free, self.clock_rate.is_free)
        full[:, first : first + len(found)] = block.matrix
        return full

    def _filtered(
        self,
        piece: ModalRegression | StackedRegression,
        output: int,
        columns: FloatArray,
        passes: dict[tuple[int, int], NoisePass],
    ) -> FloatArray:
        """Return columns as the noise of an output sees them, each record for itself, in units of its level."""
        result = np.empty_like(columns)
        owned = zip(piece.segments[output], self.noises[output], self.levels[output], strict=True)
        for number, ((_, part), noise, level) in enumerate(owned):
            if part.stop > part.start:
                passed = passes.setdefault((output, number), NoisePass(noise))
                columns[part, -1] = passed.moved(columns[part, -1])
                np.divide(passed.apply(columns[part]), max(float(level), 1e-300), out=result[part])
        return result

    def _with_priors(self, linear: _Linearisation, point: FitPoint) -> tuple[FloatArray, FloatArray]:
        rows, values = [], []
        place = 2 * len(point.omegas)
        clock = ((self.latency, point.clock.latency), (self.clock_rate, point.clock.rate))
        for prior, value in clock:
            if not prior.is_free:
                continue
            if np.isfinite(prior.sd):
                row = np.zeros(linear.design.shape[1])
                # A prior is one more observation of the parameter, already white.
                row[place] = 1.0 / prior.sd
                rows.append(row)
                values.append((prior.mean - value) / prior.sd)
            place += 1
        if self.priors:
            clock_values = [value for prior, value in clock if prior.is_free]
            present = np.concatenate([np.log(point.omegas), point.zetas, clock_values, *point.coefficients])
            for places, mean, sd in self.priors:
                row = np.zeros(linear.design.shape[1])
                row[list(places)] = 1.0 / sd
                rows.append(row)
                values.append((mean - float(np.sum(present[list(places)]))) / sd)
        if not rows:
            return linear.design, linear.residuals
        return np.vstack([linear.design, *rows]), np.append(linear.residuals, values)

    def _moved(self, point: FitPoint, change: FloatArray) -> FitPoint:
        n = len(point.omegas)
        place = 2 * n
        latency, rate = point.clock.latency, point.clock.rate
        if self.latency.is_free:
            latency += float(change[place])
            place += 1
        if self.clock_rate.is_free:
            rate += float(change[place])
            place += 1
        coefficients = []
        for found in point.coefficients:
            coefficients.append(found + change[place : place + len(found)])
            place += len(found)
        return FitPoint(
            # The parameter is log omega: a step multiplies.
            point.omegas * np.exp(change[:n]),
            np.clip(point.zetas + change[n : 2 * n], MIN_DAMPING, MAX_DAMPING),
            ClockState(latency, rate),
            tuple(coefficients),
        )

    def _filters(
        self, disturbances: Sequence[tuple[InputDisturbance, Observations]]
    ) -> list[DisturbanceFilter]:
        jitters = self.jitters or [None] * len(disturbances)
        return [
            disturbance.filter(
                observations, own, jitter.sd_s * jitter.speeds if jitter and jitter.sd_s > 0.0 else None
            )
            for (disturbance, observations), own, jitter in zip(
                disturbances, self.record_variances, jitters, strict=True
            )
        ]

    def _disturbances(self, point: FitPoint) -> list[tuple[InputDisturbance, Observations]]:
        """Return the noise of every record's input and where it is seen."""
        assert self.smoothing is not None
        shared = np.array([found[: self.n_shared] for found in point.coefficients])
        return disturbances_by_record(
            self._driven, self.records, point.omegas, point.zetas, shared, point.clock.latency, self.smoothing
        )

    def _adjust_variances(
        self, white: list[FloatArray], residuals: Sequence[FloatArray], least_share: float
    ) -> None:
        """Move the outputs' own variances to where the innovations have unit power."""
        for output, (own, plain) in enumerate(zip(white, residuals, strict=True)):
            for record, part in self.regression.segments[output]:
                # E v^2 = 1 - n_parameters / n where sigma_j^2 is right. Never below a share of the residuals'
                # power: an output may otherwise be explained by the input's noise altogether.
                power = float(np.mean(np.square(own[part])))
                least = least_share * float(np.mean(np.square(plain[part])))
                least *= min(float(self.own_shares[record, output]), 1.0)
                before = self.record_variances[record, output]
                self.record_variances[record, output] = max(before * power / self.freedom, least)

    def on_likely_inputs(self) -> tuple[list[TimeRecord], FloatArray]:
        """Return the records on their most likely inputs under the given fit, and the outputs' own variances there.

        The outputs hold what leaves the residuals of the inputs as measured: rows as the last fit has them, at which
        other modes can be tried. Samples that no row holds are NaN.

        Returns
        -------
        tuple
            Records, and variances of shape (n_records, n_outputs).
        """
        fit = self.fit
        point = FitPoint(fit.omegas, fit.zetas, fit.clock, fit.coefficients)
        residuals = self._residuals(point)
        disturbances = self._disturbances(point)
        for _ in range(_LEVEL_TURNS):
            filters = self._filters(disturbances)
            white = [own[:, None].copy() for own in residuals]
            for own in filters:
                own.whiten(white)
            self._adjust_variances(white, residuals, _MIN_VARIANCE_IN_SEARCH)
        for own in filters:
            own.weigh(white)
        cleaned = self._cleaned(disturbances, [own[:, 0] for own in white])
        left = residuals_of(cleaned, fit.omegas, fit.zetas, fit.clock, fit.coefficients)
        records = []
        for index, (record, (drive,)) in enumerate(zip(self.records, cleaned.inputs, strict=True)):
            signals = {signal.name: np.full(len(signal.values), np.nan) for signal in record.outputs}
            for j, name in enumerate(cleaned.output_names):
                for _, part in (own for own in cleaned.segments[j] if own[0] == index):
                    places = np.isin(record.output(name).times_s, cleaned.times[j][part])
                    signals[name][places] = (cleaned.values[j] + residuals[j] - left[j])[part]
            outputs = tuple(dataclasses.replace(own, values=signals[own.name]) for own in record.outputs)
            records.append(dataclasses.replace(record, inputs=(drive,), outputs=outputs))
        return records, self.record_variances

    def _cleaned(
        self, disturbances: list[tuple[InputDisturbance, Observations]], weighted: list[FloatArray]
    ) -> ModalRegression:
        """Return the regression on the most likely true inputs."""
        assert self.smoothing is not None
        values = []
        for disturbance, observations in disturbances:
            # a_hat = (a + nu) - nu_hat, both behind the low-pass.
            added = disturbance.most_likely(observations, weighted)
            values.append(self.smoothing.of(disturbance.drive).values + added)
        return self._on_inputs(values, is_smooth=True)

    def _on_inputs(self, values: Sequence[FloatArray], is_smooth: bool = False) -> ModalRegression:
        """Return the regression on other samples of every input."""
        records = []
        for record, drive, own in zip(self.records, self._driven.drives, values, strict=True):
            changed = dataclasses.replace(drive, values=own)
            records.append(TimeRecord((changed,), record.outputs, record.start_ns, record.name))
        smoothing = None if is_smooth else self.smoothing
        driven = self._driven
        found = ModalRegression(records, driven.structure, None, smoothing, driven.restarts)
        return found.with_own_columns(driven.own_columns)

    def _stretch(self) -> WeightedFit | None:
        """Return the same on a stretch from the middle of every record; None where not all outputs are seen there."""
        records = []
        for record in self.records:
            busiest = max((output.times_s for output in record.outputs), key=len)
            first = max((len(busiest) - _STRETCH) // 2, 0)
            times = busiest[first : first + _STRETCH]
            with contextlib.suppress(IdentificationError):
                records.append(record.between(float(times[0]), float(times[-1])))
        driven = self._driven
        try:
            regression = ModalRegression(records, driven.structure, driven.drives[0].name, self.smoothing)
        except IdentificationError:
            return None
        if regression.output_names != driven.output_names or len(records) < len(self.records):
            return None
        fit = self.fit
        result = WeightedFit(records, regression, fit, self.latency, self.clock_rate, self.smoothing)
        result.record_variances = self.record_variances
        if self._scatters:
            speeds = output_speeds(regression, fit.omegas, fit.zetas, fit.clock, fit.coefficients)
            result.jitters = tuple(
                dataclasses.replace(
                    own, speeds=Observations.of_record(regression, index, fit.clock.latency).table(speeds)
                )
                for index, own in enumerate(self.jitters)
            )
        return result

    @cached_property
    def _drawn(self) -> tuple[WeightedFit, NoiseDraws]:
        """Return draws of the noise, and the fit to whose rows they belong: of a long record to a stretch of it."""
        own = (self._stretch() if self._is_long else None) or self
        assert own.smoothing is not None
        clock_is_free = self.latency.is_free, self.clock_rate.is_free

        def on_inputs(values: Sequence[FloatArray]) -> ModalRegression:
            return own._on_inputs(values, is_smooth=True)

        return own, NoiseDraws(own._driven, own.smoothing, on_inputs, self.n_shared, clock_is_free)

    def _noise_score(self, point: FitPoint, filters: Sequence[DisturbanceFilter]) -> NoiseScore | None:
        """Return what noise on the inputs does to the score, None where it does not matter."""
        if not self._is_driven_by_noise:
            return None
        own, draws = self._drawn
        if own is not self:
            own.record_variances = self.record_variances
            filters = own._filters(own._disturbances(point))
        spreads = [np.sqrt(own._row_variances(output)) for output in range(len(point.coefficients))]
        score = draws.score(point, spreads, filters, own.jitters)
        return score.of_longer(self.regression.n_samples / own.regression.n_samples)

    def _row_variances(self, output: int) -> FloatArray:
        """Return the variance of an output's own noise at every row."""
        result = np.empty(len(self.regression.values[output]))
        for record, part in self.regression.segments[output]:
            result[part] = self.record_variances[record, output]
        return result

    def _finished(
        self,
        point: FitPoint,
        linear: _Linearisation,
        inverse: FloatArray,
        noise: NoiseScore | None,
        steps: int,
    ) -> ModalFit:
        """Return the fit, with what correlation is left in the innovations in its covariance."""
        inflations = [
            np.concatenate(
                [
                    np.full(part.stop - part.start, own.inflation)
                    for own, (_, part) in zip(noises, segments, strict=True)
                ]
            )
            for noises, segments in zip(self.noises, self.regression.segments, strict=False)
        ]
        touched = [self._touched(output) for output in range(len(point.coefficients))]
        places = [piece.places for piece in self.regression.pieces]
        # The filter knows no noise that outputs share: it weighs as if there were none, and the covariance counts it.
        left = None if self.smoothing is None else SharedNoise.of(linear.innovations, self._rows_together())
        covariance = _sandwich(
            inverse, linear.innovations, touched, linear.whitened, inflations, left, places
        )
        if noise is not None:  # (I.18)
            covariance = covariance + inverse @ (noise.scatter + noise.mean_error) @ inverse
        residuals = self._residuals(point)
        powers = np.array([float(np.mean(np.square(r))) for r in residuals])
        for output, noises in enumerate(self.noises):
            kept = [
                own.counted(residuals[output][part])
                for own, (_, part) in zip(noises, self.regression.segments[output], strict=True)
            ]
            powers[output] = float(np.mean(np.square(np.concatenate(kept))))
        shares = np.zeros(len(residuals))
        if self.smoothing is not None and not self._scatters:
            own_powers = [float(np.mean(self._row_variances(j))) for j in range(len(residuals))]
            shares = np.clip(1.0 - np.array(own_powers) / powers, 0.0, 1.0)
        return dataclasses.replace(
            self.fit,
            omegas=point.omegas,
            zetas=point.zetas,
            clock=point.clock,
            coefficients=point.coefficients,
            residuals=residuals,
            sigmas=np.sqrt(powers / self.freedom),
            covariance=0.5 * (covariance + covariance.T),
            input_noise_shares=shares,
            noises=tuple(
                tuple(self._said(output, own) for own in noises) for output, noises in enumerate(self.noises)
            )
            or self._said_of_stamps(),
            spreads=self._spreads(),
            innovations=linear.innovations if left is None else self._unshared(left, linear.innovations),
            iterations=self.fit.iterations + steps,
        )

    @staticmethod
    def _unshared(noise: SharedNoise, innovations: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
        """Return innovations without what outputs share."""
        columns = [own[:, None] for own in innovations]
        return tuple(
            own[:, 0] for own in noise.unshared(columns, [slice(0, len(own)) for own in innovations])
        )

    def _said(self, output: int, noise: RecordNoise) -> str:
        """Return what is said of an output's noise in one record; nothing where it is plain."""
        share = 0.0 if self.shared is None else self.shared.share(output)
        if share < _MENTIONED:
            return "" if noise.is_plain else str(noise)
        return f"{noise}, {share:.0%} of it shared with other outputs"

    def _spreads(self) -> tuple[FloatArray, ...]:
        """Return the noise of every output's rows over that of all, where stamps scatter."""
        if not self._scatters:
            return ()
        powers = [self._row_variances(output) for output in range(len(self.regression.values))]
        for record, jitter in enumerate(self.jitters):
            rows = Observations.of_record(self._driven, record, 0.0).rows
            for output, own in enumerate(powers):
                seen = rows[:, output] >= 0
                own[rows[seen, output]] += np.square(jitter.sd_s * jitter.speeds[seen, output])
        return tuple(np.sqrt(own / float(np.mean(own))) for own in powers)

    def _said_of_stamps(self) -> tuple[tuple[str, ...], ...]:
        """Return what is said of the noise of every output in each of its records."""
        if not self._scatters:
            return ()
        said = [str(own) if own.sd_s > 0.0 else "" for own in self.jitters]
        return tuple(tuple(said[record] for record, _ in own) for own in self.regression.segments)


def _without_feigned(inverse: FloatArray, noise: FloatArray) -> FloatArray:
    """Return ``(H - N)^-1`` of (I.18) from ``H^-1`` and N, the information that noise in the derivatives feigns."""
    # With H^-1 = root root^T and root^T N root = U s U^T it is (root U) (1 - s)^-1 (root U)^T. Beyond the limit
    # on s, H - N is a difference of two numbers that the draws do not tell apart.
    scale = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    values, vectors = np.linalg.eigh(inverse / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    shares, turned = np.linalg.eigh(root.T @ (noise * np.outer(scale, scale)) @ root)
    spread = (root @ turned) / np.sqrt(1.0 - np.clip(shares, 0.0, _MAX_FEIGNED))
    return np.asarray((spread @ spread.T) * np.outer(scale, scale))


def _sandwich(
    inverse: FloatArray,
    innovations: Sequence[FloatArray],
    touched: Sequence[IndexArray],
    whitened: Callable[[], Iterable[Sequence[FloatArray]]],
    inflations: Sequence[FloatArray],
    shared: SharedNoise | None,
    places: Sequence[Sequence[slice]],
) -> FloatArray:
    """Return the covariance (I.11) under the colour that the innovations still have, from that without colour.

    Parameters
    ----------
    inverse : ndarray -- of the information
    innovations : sequence of ndarray -- of every output
    touched : sequence of ndarray -- which parameters go with the columns of every output
    whitened : callable -- returns D and w side by side, of every output, piece by piece
    inflations : sequence of ndarray -- of every output, by what the variance of its rows grows; none is one
    shared : SharedNoise or None -- what the innovations still share, all of which touch all parameters then
    places : sequence of sequence of slice -- rows of every output in every piece
    """
    # The sandwich (I.11), H^-1 + H^-1 (S - D^T D) H^-1: S counts the colour that the innovations still have.
    colours = [autoregression(own) for own in innovations]
    sums = {output: ScoreCovariance(colour) for output, colour in enumerate(colours) if len(colour) > 1}
    grown = [output for output, own in enumerate(inflations) if np.any(own != 1.0)]
    if not sums and not grown and shared is None:
        return inverse
    excess, done = np.zeros_like(inverse), [0] * len(innovations)
    # What outputs share is taken to have the colour that all of them have on average.
    behind = [ColouredRows(autoregression(np.concatenate(innovations))) for _ in innovations if shared]
    for here, columns in zip(places, whitened(), strict=True):
        if shared is not None:
            designs = zip(behind, columns, strict=True)
            excess += shared.excess([own.passed(rows[:, :-1]) for own, rows in designs], here)
        for output, own in sums.items():
            own.add(columns[output][:, :-1])
        for output in grown:
            design, first = columns[output][:, :-1], done[output]
            done[output] += len(design)
            more = inflations[output][first : first + len(design)] - 1.0
            excess[np.ix_(touched[output], touched[output])] += design.T @ (design * more[:, None])
    for output, own in sums.items():
        excess[np.ix_(touched[output], touched[output])] += own.total - own.white
    return np.asarray(inverse + inverse @ excess @ inverse)
