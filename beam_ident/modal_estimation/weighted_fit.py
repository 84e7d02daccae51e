"""The last step of a fit: every sample weighed by the noise as it is.

Least squares with equal weights is unbiased while the input is known and the outputs'
noise is independent of it, of any colour, but it is neither the most precise
estimate nor are its plain intervals right.  The residuals of such a fit show the noise:

- with a known input, the colour of every output's residuals in every record (an autoregression or, at stamps of
  any spacing, a process in continuous time) whitens residuals and derivatives alike (generalised least squares);
  outliers are left out, and what is left weighs by Student's t (``noise.noise_model``);
- with noise on the input, a Kalman filter does (``modal_estimation.input_disturbance``), and the
  derivatives are those at the most likely true input.  With them the score has mean zero
  at the true parameters, which takes away the bias of errors in variables: it is
  the maximum of the likelihood over parameters *and* input, ``min r^T Sigma^-1 r``
  (weighted total least squares; Soderstrom, Errors-in-Variables Methods, 2018).

Gauss-Newton steps on all parameters, the linear ones included, end where both hold.

Equation numbers are those of docs/identification.md.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import FloatArray, IndexArray
from beam_ident.data.prior import Prior
from beam_ident.data.records import InputSignal, TimeRecord
from beam_ident.errors import IdentificationError
from beam_ident.modal.condensed_columns import residuals_of
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.regression import ClockState, ColumnBlock, ModalRegression
from beam_ident.modal.stacked_regression import StackedRegression
from beam_ident.modal_estimation.input_disturbance import DisturbanceFilter, InputDisturbance, Observations
from beam_ident.modal_estimation.record_levels import output_speeds
from beam_ident.modal_estimation.variable_projection import MAX_DAMPING, MIN_DAMPING
from beam_ident.noise.autoregression import ScoreCovariance, autoregression
from beam_ident.noise.input_noise import Smoothing
from beam_ident.noise.noise_model import NoisePass, RecordNoise, Whitening
from beam_ident.noise.scores import are_rounding
from beam_ident.numerics.linear_least_squares import LinearSolution, StackedTriangle
from beam_ident.sensing.stamp_jitter import StampJitter

_MAX_STEPS = 15
_MAX_STEPS_AMONG_OUTLIERS = 40  # weights by the tails settle more slowly
_LOOKS = 2  # at the noise, once the fit has left what outliers did to its start
_STEP_TOLERANCE = 1e-2  # of a standard deviation, per parameter
_NEAR = 0.5  # the same, from where on the weights of rounded values need no caution
_MAX_STEP = 0.1  # of a natural frequency
_MAX_TRAVEL = 6.0  # standard deviations by which weights alone may move a pole
_MAX_TRAVEL_WITH_INPUT = 200.0  # the same where noise on the input has biased the start
_DRAWS = 8  # of records with thousands of samples
_DRAWN = 100_000  # samples of an output over all draws: those of a long record need less repetition
_AT_ONCE = 50_000  # samples of an output that draws may hold together
_STRETCH = 12_500  # samples of an output that are drawn for a long record, too few to be long themselves
_MAX_FEIGNED = 0.9  # share of the information on a parameter, beyond which N is no better known than H - N
_MIN_VARIANCE = 0.05  # of the residuals': an output is never taken to be less noisy than this


@dataclass(frozen=True, eq=False)
class _Point:
    """Parameters, in the order of ``ModalFit.covariance``."""

    omegas: FloatArray
    zetas: FloatArray
    clock: ClockState
    coefficients: tuple[FloatArray, ...]


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
    disturbances: tuple[tuple[InputDisturbance, Observations], ...] = ()


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
        self._is_near = False
        if smoothing is None:
            self._take_noise(fit.residuals)

    def _take_noise(self, residuals: Sequence[FloatArray]) -> None:
        """Let every record weigh by the noise that residuals show there; what it was taken for at first stays."""
        known, self.noises, self.levels = self.noises, [], []
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

    @property
    def is_needed(self) -> bool:
        """Whether the noise is other than what the fit took it for."""
        is_coloured = any(not own.is_plain for noises in self.noises for own in noises)
        return self.smoothing is not None or is_coloured or bool(self.priors)

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
        point = _Point(fit.omegas, fit.zetas, fit.clock, fit.coefficients)
        travelled = np.zeros(len(fit.covariance))
        reach = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-300))
        farthest = _MAX_TRAVEL if self.smoothing is None else _MAX_TRAVEL_WITH_INPUT
        looks = 0
        for step in range(1, (_MAX_STEPS_AMONG_OUTLIERS if self._follows else _MAX_STEPS) + 1):
            # One step of (I.10); with noise on the input D holds the derivatives of (I.15).
            linear = self._linearise(point)
            design, right = self._with_priors(linear, point)
            solution = LinearSolution.of(design)
            change = solution.coefficients(right)
            travelled += change
            # Hausman's comparison: under the right noise both estimates differ by no more than both scatter.
            if not np.max(np.abs(travelled / reach)[: self.n_theta]) < farthest:
                reason = "weighing by the noise moves the poles further than noise can; weights are equal"
                if self._is_driven_by_noise:
                    reason = f"{reason}. Check the sigma that is stated for the input"
                return dataclasses.replace(fit, converged=self._keeps_equal_weights(fit), reason=reason)
            if not np.max(np.abs(change[: len(fit.omegas)])) < _MAX_STEP:
                break
            point = self._moved(point, change)
            # D step is the step in units of its standard deviation: |D step|^2 = step^T H step.
            size = float(np.linalg.norm(design @ change)) / math.sqrt(len(change))
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
                return self._finished(point, linear, solution.inverse_gram(), step)
            del linear  # holds an input of its own, which a long record has no room for twice
        reason = "weighing by the noise did not settle; weights are equal"
        return dataclasses.replace(fit, converged=self._keeps_equal_weights(fit), reason=reason)

    def _keeps_equal_weights(self, fit: ModalFit) -> bool:
        """Return whether equal weights are an answer: not where the input's noise biases them."""
        return fit.converged and not self._is_driven_by_noise

    @property
    def _is_long(self) -> bool:
        return len(self.regression.pieces) > 1

    def _linearise(self, point: _Point) -> _Linearisation:
        driving = self.regression
        filters: list[DisturbanceFilter] = []
        disturbances: list[tuple[InputDisturbance, Observations]] = []
        residuals: Sequence[FloatArray] | None = None
        if self.smoothing is not None:
            residuals = self._residuals(point)
            if self._is_long:
                self._driven.release()
            # The innovations L^-1 r of (I.16) have unit power where the sigma_j^2 are right.
            disturbances = self._disturbances(point)
            filters = self._filters(disturbances)
            white = [r[:, None].copy() for r in residuals]
            for own in filters:
                own.whiten(white)
            self._adjust_variances(white, residuals)
            for own in filters:
                own.weigh(white)
            # Sigma^-1 r of (I.17), and from it the most likely input a_hat of (I.14). The derivatives are those at
            # a_hat, (I.15); the residuals stay those against the measured input, (I.12).
            driving = self._cleaned(disturbances, [w[:, 0] for w in white])
        elif self._follows and self._is_long:
            self._take_noise(self._residuals(point))  # the weights of tails go with the residuals

        def whitened() -> Iterator[list[FloatArray]]:
            yield from self._whitened(point, driving, filters, residuals)
            if self._is_long and isinstance(driving, ModalRegression) and driving is not self.regression:
                driving.release()  # there is room for the signals of one long input, not of two

        if self._is_long:
            return self._condensed(whitened, filters, disturbances)
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
            tuple(disturbances),
        )

    def _condensed(
        self,
        whitened: Callable[[], Iterable[Sequence[FloatArray]]],
        filters: Sequence[DisturbanceFilter],
        disturbances: Sequence[tuple[InputDisturbance, Observations]],
    ) -> _Linearisation:
        """Return D and w of a long record in as many rows as the outputs touch columns."""
        n_outputs = len(self.fit.coefficients)
        # Rows of outputs that share no parameter but poles and clock need not be turned together.
        n_turned = n_outputs if self.smoothing is None else 1
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
            tuple(disturbances),
        )

    def _whitened(
        self,
        point: _Point,
        driving: ModalRegression | StackedRegression,
        filters: Sequence[DisturbanceFilter],
        residuals: Sequence[FloatArray] | None,
    ) -> Iterator[list[FloatArray]]:
        """Yield D and w of (I.10) side by side, of every output, piece by piece.

        One pass of a filter whitens both: ``L^-1 (dM/deta a_hat)`` and ``L^-1 r``.

        Parameters
        ----------
        point : _Point
        driving : ModalRegression or StackedRegression -- on the inputs at which the derivatives are taken
        filters : sequence of DisturbanceFilter -- of every record, where the input's noise matters
        residuals : sequence of ndarray or None
            Against the measured input, of every output; None where the derivatives are at that input, too.
        """
        passes: dict[tuple[int, int], NoisePass] = {}
        states: dict[int, FloatArray] = {}
        pieces: Sequence[ModalRegression | StackedRegression] = self.regression.pieces
        drivings: Sequence[ModalRegression | StackedRegression] = driving.pieces
        for piece, driven in zip(pieces, drivings, strict=True):
            blocks = driven.blocks(point.omegas, point.zetas, point.clock, gradients=True)
            columns = []
            for output, (block, found) in enumerate(zip(piece.block_of, point.coefficients, strict=True)):
                rows = self._columns(output, blocks[block], found)
                if residuals is None:
                    rows[:, -1] = piece.values[output] - blocks[block].matrix @ found
                else:
                    rows[:, -1] = residuals[output][piece.places[output]]
                columns.append(rows)
            if not filters:
                if self._follows and not self._is_long:
                    # The weights of tails go with the residuals.
                    self._take_noise([rows[:, -1].copy() for rows in columns])
                columns = [self._filtered(piece, output, rows, passes) for output, rows in enumerate(columns)]
            elif isinstance(piece, ModalRegression) and piece.record is not None:
                # The filter's state goes on from piece to piece.
                own = filters[piece.record]
                states[piece.record] = own.whiten(columns, piece.places, states.get(piece.record))
            else:
                for own in filters:
                    own.whiten(columns)
            yield columns

    def _residuals(self, point: _Point) -> tuple[FloatArray, ...]:
        """Return the residuals against the measured input, of every output."""
        return tuple(
            residuals_of(self.regression, point.omegas, point.zetas, point.clock, point.coefficients)
        )

    def _touched_slices(self, output: int) -> list[tuple[slice, slice]]:
        """Return which parameters an output's whitened rows depend on, and the columns that hold them."""
        sizes, n = [len(found) for found in self.fit.coefficients], self.n_theta
        if self.smoothing is not None:  # the filter mixes the outputs
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
        if self.smoothing is not None:
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

    def _with_priors(self, linear: _Linearisation, point: _Point) -> tuple[FloatArray, FloatArray]:
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

    def _moved(self, point: _Point, change: FloatArray) -> _Point:
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
        return _Point(
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

    def _disturbances(self, point: _Point) -> list[tuple[InputDisturbance, Observations]]:
        """Return the noise of every record's input and where it is seen."""
        regression = self._driven
        assert self.smoothing is not None
        shared = np.array([found[: self.n_shared] for found in point.coefficients])
        result = []
        for index, drive in enumerate(regression.drives):
            names = [o.name for o in self.records[index].outputs]
            exposures = np.array(
                [
                    self.records[index].output(name).exposure_s if name in names else 0.0
                    for name in regression.output_names
                ]
            )
            disturbance = InputDisturbance(
                drive, regression.structure, point.omegas, point.zetas, shared, exposures, self.smoothing
            )
            result.append((disturbance, Observations.of_record(regression, index, point.clock.latency)))
        return result

    def _adjust_variances(self, white: list[FloatArray], residuals: Sequence[FloatArray]) -> None:
        """Move the outputs' own variances to where the innovations have unit power."""
        for output, (own, plain) in enumerate(zip(white, residuals, strict=True)):
            for record, part in self.regression.segments[output]:
                # E v^2 = 1 - n_parameters / n where sigma_j^2 is right. Never below a share of the residuals'
                # power: an output may otherwise be explained by the input's noise altogether.
                power = float(np.mean(np.square(own[part])))
                least = _MIN_VARIANCE * float(np.mean(np.square(plain[part])))
                least *= min(float(self.own_shares[record, output]), 1.0)
                before = self.record_variances[record, output]
                self.record_variances[record, output] = max(before * power / self.freedom, least)

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
        return found.with_own_columns(driven.own_columns) if driven.own_columns else found

    def _without_feigned_information(
        self, point: _Point, linear: _Linearisation, covariance: FloatArray
    ) -> FloatArray:
        """Return the covariance (I.18), without the information that noise in the derivatives only feigns.

        Notes
        -----
        Of the information H at the most likely input, N is that of what is left of the noise
        there, which is independent of the weighed residuals.  So the score varies with H and
        answers to a change of the parameters with ``H - N``: the covariance is ``(H - N)^-1 H
        (H - N)^-1``, with N from a few seeded draws (Fuller, Measurement Error Models, 1987).
        """
        noise = self._feigned(point, linear.disturbances, linear.filters)
        # With H^-1 = root root^T and root^T N root = U s U^T, (I.18) is (root U) (1 - s)^-2 (root U)^T. Beyond
        # the limit on s, H - N is a difference of two numbers that the draws do not tell apart.
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        shares, turned = np.linalg.eigh(root.T @ (noise * np.outer(scale, scale)) @ root)
        spread = (root @ turned) / (1.0 - np.clip(shares, 0.0, _MAX_FEIGNED))
        return np.asarray((spread @ spread.T) * np.outer(scale, scale))

    def _feigned(
        self,
        point: _Point,
        disturbances: Sequence[tuple[InputDisturbance, Observations]],
        filters: Sequence[DisturbanceFilter],
    ) -> FloatArray:
        """Return N of (I.18), shape as the covariance.

        Notes
        -----
        What is left of the noise does not depend on the input, so that N grows with the length of a record alone:
        that of a long one is known from a stretch of it.
        """
        if self._is_long and (stretch := self._stretch()) is not None:
            own = stretch._disturbances(point)
            own_filters = stretch._filters(own)
            grown = self.regression.n_samples / stretch.regression.n_samples
            return np.asarray(grown * stretch._feigned(point, own, own_filters))
        # N of (I.18) comes through the poles, gains and residues alone: offset, ramp and free motion do not pass
        # the input.
        shared = [found[: self.n_shared] for found in point.coefficients]
        longest = max(len(values) for values in self.regression.values)
        n_draws, at_once = min(_DRAWS, math.ceil(_DRAWN / longest)), max(_AT_ONCE // longest, 1)
        rng, total = np.random.default_rng(0), len(self.fit.covariance)
        noise = np.zeros((total, total))
        for first in range(0, n_draws, at_once):
            some = min(at_once, n_draws - first)
            left = self._left_noise(point, disturbances, filters, shared, rng, some)
            # Several draws in one pass of the filter; N is the mean of D_left^T D_left over all.
            together = self._noise_columns(point, left, shared)
            for own_filter in filters:
                own_filter.whiten(together)
            for columns in together:
                rows = columns.reshape(-1, total)
                noise += rows.T @ rows / n_draws
        return noise

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

    def _noise_columns(
        self, point: _Point, left: Sequence[Sequence[FloatArray]], shared: Sequence[FloatArray]
    ) -> list[FloatArray]:
        """Return the derivatives by all parameters at noise on the inputs, draw beside draw, of every output."""
        draws: list[list[FloatArray]] = []
        sizes = [len(found) for found in self.fit.coefficients]
        for noise in left:
            regression = self._on_inputs(noise, is_smooth=True)
            blocks = regression.blocks(point.omegas, point.zetas, point.clock, gradients=True)
            columns, first = [], self.n_theta
            for number, own, size in zip(regression.block_of, shared, sizes, strict=True):
                block = blocks[number]
                full = np.zeros((len(block.matrix), len(self.fit.covariance)), order="F")
                full[:, : self.n_theta] = block.slopes(
                    _padded(own, block), self.latency.is_free, self.clock_rate.is_free
                )
                full[:, first : first + len(own)] = block.matrix[:, : len(own)]
                columns.append(full)
                first += size
            draws.append(columns)
        return [np.concatenate(own, axis=1).copy(order="C") for own in zip(*draws, strict=True)]

    def _left_noise(
        self,
        point: _Point,
        disturbances: Sequence[tuple[InputDisturbance, Observations]],
        filters: Sequence[DisturbanceFilter],
        shared: Sequence[FloatArray],
        rng: np.random.Generator,
        n_draws: int,
    ) -> list[list[FloatArray]]:
        """Return draws of what noise is left on every record's most likely input."""
        assert self.smoothing is not None
        regression = self._driven
        inputs: list[list[FloatArray]] = []
        residuals = [np.empty((len(values), n_draws)) for values in regression.values]
        for draw in range(n_draws):
            noise = []
            for drive in regression.drives:
                # A draw of r = e - H nu as in (I.12), at the estimate and with its variances.
                values = drive.sigma * rng.standard_normal(len(drive.values))
                raw = InputSignal(drive.name, drive.unit, drive.times_s, values, drive.hold)
                noise.append(self.smoothing.of(raw).values)
            inputs.append(noise)
            blocks = self._on_inputs(noise, is_smooth=True).blocks(
                point.omegas, point.zetas, point.clock, gradients=False
            )
            for output, block in enumerate(regression.block_of):
                own = rng.standard_normal(len(residuals[output])) * np.sqrt(self._row_variances(output))
                matrix = blocks[block].matrix
                residuals[output][:, draw] = own - matrix @ _padded(shared[output], blocks[block])
            self._add_late_stamps(residuals, draw, disturbances, rng)
        for own_filter in filters:
            own_filter.whiten(residuals)
            own_filter.weigh(residuals)
        for draw, noise in enumerate(inputs):
            weighted = [values[:, draw] for values in residuals]
            for index, (disturbance, observations) in enumerate(disturbances):
                # nu - nu_hat: what the most likely input still holds of this draw's noise.
                noise[index] = noise[index] + disturbance.most_likely(observations, weighted)
        return inputs

    def _add_late_stamps(
        self,
        residuals: Sequence[FloatArray],
        draw: int,
        disturbances: Sequence[tuple[InputDisturbance, Observations]],
        rng: np.random.Generator,
    ) -> None:
        """Add a draw of what the stamps' jitter does to the outputs, in place."""
        for jitter, (_, observations) in zip(self.jitters, disturbances, strict=False):
            if jitter.sd_s > 0.0:
                late = jitter.sd_s * rng.standard_normal(len(observations.times))
                for output, rows in enumerate(observations.rows.T):
                    seen = rows >= 0
                    residuals[output][rows[seen], draw] += (late * jitter.speeds[:, output])[seen]

    def _row_variances(self, output: int) -> FloatArray:
        """Return the variance of an output's own noise at every row."""
        result = np.empty(len(self.regression.values[output]))
        for record, part in self.regression.segments[output]:
            result[part] = self.record_variances[record, output]
        return result

    def _finished(self, point: _Point, linear: _Linearisation, inverse: FloatArray, steps: int) -> ModalFit:
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
        covariance = _sandwich(inverse, linear.innovations, touched, linear.whitened, inflations)
        reason = self.fit.reason
        if self._is_driven_by_noise:
            try:
                covariance = self._without_feigned_information(point, linear, covariance)
            except (KeyboardInterrupt, MemoryError) as stop:
                what = "the memory did not suffice" if isinstance(stop, MemoryError) else "interrupted"
                reason = (
                    f"{what}; standard deviations count information that noise on the input may only feign"
                )
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
            noises=tuple(tuple("" if own.is_plain else str(own) for own in noises) for noises in self.noises)
            or self._said_of_stamps(),
            spreads=self._spreads(),
            converged=self.fit.converged and reason == self.fit.reason,
            reason=reason,
            iterations=self.fit.iterations + steps,
        )

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


def _padded(shared: FloatArray, block: ColumnBlock) -> FloatArray:
    """Return linear parameters of a block's columns of which only the first are not zero."""
    result = np.zeros(block.matrix.shape[1])
    result[: len(shared)] = shared
    return result


def _sandwich(
    inverse: FloatArray,
    innovations: Sequence[FloatArray],
    touched: Sequence[IndexArray],
    whitened: Callable[[], Iterable[Sequence[FloatArray]]],
    inflations: Sequence[FloatArray],
) -> FloatArray:
    """Return the covariance (I.11) under the colour that the innovations still have, from that without colour.

    Parameters
    ----------
    inverse : ndarray -- of the information
    innovations : sequence of ndarray -- of every output
    touched : sequence of ndarray -- which parameters go with the columns of every output
    whitened : callable -- returns D and w side by side, of every output, piece by piece
    inflations : sequence of ndarray -- of every output, by what the variance of its rows grows; none is one
    """
    # The sandwich (I.11), H^-1 + H^-1 (S - D^T D) H^-1: S counts the colour that the innovations still have.
    colours = [autoregression(own) for own in innovations]
    sums = {output: ScoreCovariance(colour) for output, colour in enumerate(colours) if len(colour) > 1}
    grown = [output for output, own in enumerate(inflations) if np.any(own != 1.0)]
    if not sums and not grown:
        return inverse
    excess, done = np.zeros_like(inverse), [0] * len(innovations)
    for columns in whitened():
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
