"""The output-error likelihood of transfer functions from one or several inputs to one output.

    y = sum_k B_k(s) / (s^q A_k(s)) e^(-s T_k) u_k + nuisances + noise

The denominators (one for all inputs, or one each) and the unknown delays are searched; the
numerators, offset, ramp and free motion enter linearly and are projected out (variable
projection).  All responses and gradients are exact under each input's own hold, at the
stamps as they are; the known integrators ``s^-q`` are applied to the inputs, whose
antiderivatives are exact.

One record is the usual case.  Several share denominators, numerators and delays, while every one has
nuisances and noise of its own; a noise model (``noise.noise_model``) weighs them.

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.prior import Prior
from beam_ident.errors import EstimationError
from beam_ident.noise.noise_model import NoiseModel, RecordNoise, Whitening, colour_of
from beam_ident.noise.record_fit import in_units_of_level
from beam_ident.noise.scores import Tested, are_rounding
from beam_ident.numerics.linear_least_squares import LinearSolution
from beam_ident.numerics.rational_response import RationalResponse, full_roots, upper_roots
from beam_ident.transfer_function_estimation.record_share import (
    Nuisances,
    Path,
    RecordShare,
    Response,
    joined,
)

_MIN_SAMPLES = 20
_NOISE_FLOOR = 1e-11
_MAX_POLE = 1e4  # of the Nyquist frequency
_MIN_DAMPING = 1e-9  # nearer to the imaginary axis a pole is on it but for rounding
_MIN_POLE = (
    _MIN_DAMPING  # of a coefficient, in units of the scale: below it a pole is at zero but for rounding
)
_MAX_ADVANCE = 1.0  # sampling periods: an estimated delay may come out this much below zero
_LAGS = 25  # samples for which an input is looked for in residuals


@dataclass(frozen=True, eq=False)
class OutputErrorState:
    """Everything known at one set of denominators and delays.

    Attributes
    ----------
    theta : ndarray -- coefficients of all denominators in units of ``scale``, then the free delays
    scale : float -- unit of frequency [rad/s]
    cost : float -- negative log-likelihood, infinite where the point is not allowed
    uppers : tuple of ndarray -- poles of each denominator with imaginary part >= 0
    responses : tuple of Response -- of every path, in all records
    free : tuple of tuple of RationalResponse -- of every record, of each denominator
    coefficients : ndarray
        Of the columns of ``matrix``: all numerators, then offset, ramp and free motions of each record.
    residuals : ndarray, shape (n_samples,) -- as the noise model sees them
    matrix : ndarray, shape (n_samples, n_columns) -- unweighed
    solution : LinearSolution or None -- of the weighed matrix
    """

    theta: FloatArray
    scale: float
    cost: float
    uppers: tuple[ComplexArray, ...]
    responses: tuple[Response, ...] = ()
    free: tuple[tuple[RationalResponse, ...], ...] = ()
    coefficients: FloatArray = field(default_factory=lambda: np.empty(0))
    residuals: FloatArray = field(default_factory=lambda: np.empty(0))
    matrix: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    solution: LinearSolution | None = None


@dataclass(frozen=True, eq=False)
class JointCovariance:
    """Covariance of searched and linear parameters together, in scaled units.

    Attributes
    ----------
    values : ndarray, shape (n_theta + n_columns, n_theta + n_columns)
    variance : float -- of the residuals, as the noise model sees them
    condition : float -- of the scaled information matrix
    """

    values: FloatArray
    variance: float
    condition: float


class OutputErrorProblem:
    """The likelihood of one output as a function of denominators and delays.

    Parameters
    ----------
    experiments : sequence of RecordShare -- one for every record
    orders : tuple of int -- degree of every denominator
    nuisances : Nuisances
    noise : NoiseModel or None -- None weighs all samples alike

    Raises
    ------
    EstimationError
        Too few samples, altogether or in one record, or nothing but a constant.
    """

    def __init__(
        self,
        experiments: Sequence[RecordShare],
        orders: tuple[int, ...],
        nuisances: Nuisances,
        noise: NoiseModel | None = None,
    ) -> None:
        self.experiments, self.orders, self.nuisances = tuple(experiments), orders, nuisances
        self.paths: tuple[Path, ...] = experiments[0].paths
        self.n_a = sum(orders)
        self.free_delays = [k for k, path in enumerate(self.paths) if path.delay.is_free]
        self.n_numerators = sum(path.n_zeros + 1 for path in self.paths)
        self.n_nuisances = nuisances.count(self.n_a)
        self.n_columns = self.n_numerators + len(experiments) * self.n_nuisances
        ends = np.cumsum([0, *(len(own.values) for own in experiments)])
        self.rows = [slice(int(first), int(end)) for first, end in itertools.pairwise(ends)]
        self.values = _in_a_row([own.values for own in experiments])
        self.times = _in_a_row([own.times for own in experiments])
        self._refuse_few()
        self.period = min(own.period for own in experiments)
        self.length = max(own.length for own in experiments)
        self.shortest = min(own.length for own in experiments)
        self.nyquist = np.pi / self.period
        self.scale = float(np.sqrt(2.0 * np.pi / self.length * self.nyquist))
        self.floor = len(self.values) * (_NOISE_FLOOR * float(np.max(np.abs(self.values)))) ** 2
        self.parts = np.split(np.arange(self.n_a), np.cumsum(orders)[:-1])
        self.noise = noise
        self._shown: tuple[FloatArray, NoiseModel] | None = None  # the noise at a point, for a second look
        self._target = self.weighed(self.values if noise is None else noise.moved(self.values))

    def _refuse_few(self) -> None:
        n_parameters = self.n_a + len(self.free_delays) + self.n_columns
        least = max(_MIN_SAMPLES, 3 * n_parameters)
        if len(self.values) < least:
            raise EstimationError(
                f"the output has {len(self.values)} usable samples for {n_parameters} parameters; expected at least "
                f"{least}. Record longer, or ask for a lower order"
            )
        least = max(_MIN_SAMPLES, 3 * self.n_nuisances)
        for own in self.experiments:
            if len(own.values) < least:
                raise EstimationError(
                    f"the output has {len(own.values)} usable samples in record {own.name!r}; expected at least "
                    f"{least} in each. Leave the record out"
                )
        if np.ptp(self.values) == 0.0:
            raise EstimationError(
                f"the output is constant ({self.values[0]:g}); nothing can be identified from it. Check the sensor"
            )

    def weighed(self, columns: FloatArray) -> FloatArray:
        """Return columns of shape (n_samples, ...) as the noise model sees them."""
        return columns if self.noise is None else self.noise.apply(columns)

    def under(self, noise: NoiseModel | None) -> OutputErrorProblem:
        """Return the problem under another noise model, in the same unit of frequency."""
        problem = OutputErrorProblem(self.experiments, self.orders, self.nuisances, noise)
        problem.scale = self.scale
        return problem

    def reweighed(
        self,
        state: OutputErrorState,
        as_it_is: bool,
        known: NoiseModel | None = None,
        doubt: FloatArray | None = None,
        near: NoiseModel | None = None,
    ) -> OutputErrorProblem:
        """Return the problem under the noise that a state's residuals show.

        Parameters
        ----------
        state : OutputErrorState
        as_it_is : bool
            Whether the noise has a colour, which BIC chooses, and outliers; a level of every record alone.
        known : NoiseModel or None -- whose colours and outliers stay, while levels and the weights of tails follow
        doubt : ndarray or None, shape (n_samples, n_parameters) -- what ``doubt`` says of the state
        near : NoiseModel or None -- of residuals almost like these, from which the search of a colour begins

        Notes
        -----
        The level of a record's noise is that of its residuals over the samples that the parameters leave
        free: those of the record, less its share of the trace of the projection onto the model's columns.
        """
        is_by_itself = as_it_is and known is None and doubt is None
        shown = self._noise_shown(state)
        if is_by_itself and shown is not None:
            problem = self.under(shown)
            problem.scale = state.scale
            return problem
        left = self.unweighed_residuals(state)
        noises = None
        if as_it_is:
            if known is not None and known.noises is not None:
                pairs = zip(known.noises, self.rows, strict=True)
                noises = [own.followed(left[part]) for own, part in pairs]
            else:
                noises = self._noises(left, doubt, near)
        sds = np.ones(len(self.rows))
        if len(self.rows) > 1:
            assert state.solution is not None
            # The trace of Q Q^T over a record's rows: how many of its samples the linear parameters take;
            # theta takes an equal share of every sample.
            leverage = np.einsum("ij,ij->i", state.solution.basis, state.solution.basis)
            share = len(state.theta) / len(left)
            for record, part in enumerate(self.rows):
                own = left[part]
                if noises is not None:
                    own = noises[record].apply(noises[record].moved(own))
                n_free = float(np.sum(1.0 - share - leverage[part]))
                power = float(own @ own) / max(n_free, 1.0)
                sds[record] = math.sqrt(power + self.floor / len(left) + 1e-300)
        model = NoiseModel(noises, sds, self.rows)
        if is_by_itself:
            self._shown = state.theta, model
        problem = self.under(model)
        problem.scale = state.scale
        return problem

    def _noise_shown(self, state: OutputErrorState) -> NoiseModel | None:
        """Return the noise that a state's residuals show by themselves, None where nobody looked."""
        known = self._shown
        return known[1] if known is not None and np.array_equal(known[0], state.theta) else None

    def deviance(self, state: OutputErrorState) -> tuple[float, int]:
        """Return -2 log-likelihood of an optimum, and the number of the noise's parameters.

        Parameters
        ----------
        state : OutputErrorState

        Notes
        -----
        Where the weights stayed equal although the noise has a colour or outliers, it is that of the noise as it was
        seen: otherwise no structure could be compared with one that is weighed by its noise.
        """
        shown = self._noise_shown(state)
        if shown is None or (self.noise is not None and not self.noise.is_plain):
            return 2.0 * state.cost, 0 if self.noise is None else self.noise.n_parameters
        left = shown.apply(shown.moved(self.unweighed_residuals(state)))
        misfit = len(left) * math.log(float(left @ left) + self.floor)
        return misfit + 2.0 * (shown.excess + self._misfit_of_priors(state.theta)), shown.n_parameters

    def _misfit_of_priors(self, theta: FloatArray) -> float:
        """Return the negative log-density of the delays."""
        delays = self.delays(theta)
        priors = [(delays[k], self.paths[k].delay) for k in self.free_delays]
        return float(sum(0.5 * ((delay - prior.mean) / prior.sd) ** 2 for delay, prior in priors))

    def _noises(
        self, left: FloatArray, doubt: FloatArray | None, near: NoiseModel | None
    ) -> list[RecordNoise]:
        """Return the noise that residuals show in every record; errors of arithmetic are none."""
        found = []
        for k, (part, own) in enumerate(zip(self.rows, self.experiments, strict=True)):
            doubts = None if doubt is None else doubt[part]
            colour = None if near is None or near.noises is None else near.noises[k].colour
            if are_rounding(own.values, left[part]):
                found.append(RecordNoise(Whitening(np.ones(1), own.times)))
            else:
                found.append(RecordNoise.of(own.values, left[part], own.times, doubts, colour))
        return found

    def doubt(self, state: OutputErrorState, also: FloatArray | None = None) -> FloatArray | None:
        """Return U of (I.24), by what the model is not known; None without a noise model.

        Parameters
        ----------
        state : OutputErrorState
        also : ndarray or None, shape (n_theta, n_theta) -- information on theta from elsewhere

        Returns
        -------
        ndarray or None, shape (n_samples, n_theta + n_columns) -- unweighed
        """
        if self.noise is None or not state.responses or not state.responses[0].has_squares:
            return None
        design = np.concatenate([self._gradient(state), state.matrix], axis=1)
        covariance = self.covariance(state, also).values
        sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        values, vectors = np.linalg.eigh(covariance / np.outer(sd, sd))
        return np.asarray((design * sd) @ (vectors * np.sqrt(np.maximum(values, 0.0))))

    def unweighed_residuals(self, state: OutputErrorState) -> FloatArray:
        """Return what a state leaves of the output, without weights."""
        return np.asarray(self.values - state.matrix @ state.coefficients)

    def standardised(self, residuals: FloatArray) -> FloatArray:
        """Return residuals in units of their level in every record, where there are several."""
        return in_units_of_level([residuals[part] for part in self.rows])

    def from_stamps(self, starts_s: Sequence[float]) -> OutputErrorProblem:
        """Return the problem without the samples before an instant in every record."""
        kept = [own.from_stamp(start) for own, start in zip(self.experiments, starts_s, strict=True)]
        return OutputErrorProblem(kept, self.orders, self.nuisances)

    def of_values(self, values: FloatArray, paths: Sequence[int]) -> OutputErrorProblem:
        """Return the problem of one denominator and some paths that explains other values at the same stamps."""
        experiments = [
            replace(own, values=values[part], paths=tuple(replace(own.paths[k], block=0) for k in paths))
            for own, part in zip(self.experiments, self.rows, strict=True)
        ]
        order = (self.orders[self.paths[paths[0]].block],)
        return OutputErrorProblem(experiments, order, self.nuisances)

    def at_mean_delays(self) -> OutputErrorProblem:
        """Return the problem with all delays known to be their priors' means."""
        shares = [
            replace(own, paths=tuple(replace(path, delay=Prior(path.delay.mean)) for path in own.paths))
            for own in self.experiments
        ]
        return OutputErrorProblem(shares, self.orders, self.nuisances, self.noise)

    def delays(self, theta: FloatArray) -> FloatArray:
        """Return the delay of every path [s]."""
        result = np.array([path.delay.mean for path in self.paths])
        # The given delays come from the priors' means, the free ones from theta.
        result[self.free_delays] = theta[self.n_a :]
        return result

    def polynomial(self, theta: FloatArray, block: int = 0) -> FloatArray:
        """Return a monic denominator in units of the scale, descending powers."""
        return np.concatenate([[1.0], theta[self.parts[block]]])

    def converted(self, state: OutputErrorState, scale: float) -> FloatArray:
        """Return a state's parameters in another unit of frequency."""
        powers = np.concatenate([np.arange(1, n + 1) for n in self.orders])
        theta = state.theta.copy()
        # a_i belongs to s^(n-i), so that it scales with the unit of frequency to the power i.
        theta[: self.n_a] *= (state.scale / scale) ** powers
        return np.asarray(theta)

    def point(self, theta: FloatArray, slopes: bool = True) -> OutputErrorState:
        """Compute all columns of a point, without solving for the coefficients.

        Parameters
        ----------
        theta : ndarray
        slopes : bool -- whether the point is to be improved, not only ranked

        Returns
        -------
        OutputErrorState -- of infinite cost; with no matrix where the point is not allowed
        """
        refused = OutputErrorState(theta, self.scale, math.inf, ())
        if not np.all(np.isfinite(theta)):
            return refused
        # Poles are taken to be stable; a root lost to rounding or far above the band is refused, too.
        uppers = tuple(upper_roots(self.polynomial(theta, block)) for block in range(len(self.orders)))
        largest = _MAX_POLE * self.nyquist / self.scale
        for upper, n in zip(uppers, self.orders, strict=True):
            if (
                np.any(upper.real > -_MIN_DAMPING * np.abs(upper))
                or len(full_roots(upper)) != n
                or np.max(np.abs(upper)) > largest
            ):
                return refused
        delays = self.delays(theta)
        if any(
            delays[k] < -_MAX_ADVANCE * self.period or delays[k] > self.shortest for k in self.free_delays
        ):
            return refused
        forced = [own.forced(uppers, self.scale, delays, slopes) for own in self.experiments]
        responses = tuple(joined(parts) for parts in zip(*forced, strict=True))
        free: tuple[tuple[RationalResponse, ...], ...] = ()
        if self.nuisances.has_free_response:
            free = tuple(
                tuple(own.free(upper, self.scale, slopes) for upper in uppers) for own in self.experiments
            )
        columns = [
            response.combined(np.eye(path.n_zeros + 1))
            for path, response in zip(self.paths, responses, strict=True)
        ]
        # X of (T.9): s^i/A_k u_k of every path, then the nuisances N.
        matrix = np.concatenate([*columns, *self._own_columns(free)], axis=1)
        if not np.all(np.isfinite(matrix)):
            return refused
        return OutputErrorState(theta, self.scale, math.inf, uppers, responses, free, matrix=matrix)

    def state(self, theta: FloatArray, slopes: bool = True) -> OutputErrorState:
        """Evaluate a point; without slopes it can be ranked but not improved."""
        point = self.point(theta, slopes)
        if not point.matrix.size:
            return point
        matrix = self.weighed(point.matrix)
        solution = LinearSolution.of(matrix)
        coefficients = solution.coefficients(self._target)
        # (T.9): with the noise's variance eliminated the likelihood is n/2 log of the squares left over.
        residuals = self._target - matrix @ coefficients
        cost = 0.5 * len(self.values) * math.log(float(residuals @ residuals) + self.floor)
        cost += 0.0 if self.noise is None else self.noise.excess
        cost += self._misfit_of_priors(theta)
        return replace(point, cost=cost, coefficients=coefficients, residuals=residuals, solution=solution)

    def _own_columns(self, free: tuple[tuple[RationalResponse, ...], ...]) -> list[FloatArray]:
        """Return offset, ramp and free motions of every record, zero in the others."""
        blocks = []
        for record, own in enumerate(self.experiments):
            columns = [column[:, None] for column in own.drifts(self.nuisances)]
            if free:
                columns += [response.combined(np.eye(response.order)) for response in free[record]]
            if columns:
                blocks.append(np.concatenate(columns, axis=1))
        if len(blocks) < 2:
            return blocks
        placed = np.zeros((len(self.values), len(blocks) * self.n_nuisances))
        for record, (part, block) in enumerate(zip(self.rows, blocks, strict=True)):
            first = record * self.n_nuisances
            placed[part, first : first + self.n_nuisances] = block
        return [placed]

    def numerator(self, state: OutputErrorState, path: int) -> FloatArray:
        """Return the numerator of a path in units of the scale, ascending powers."""
        place = sum(p.n_zeros + 1 for p in self.paths[:path])
        return np.asarray(state.coefficients[place : place + self.paths[path].n_zeros + 1])

    def jacobian(self, state: OutputErrorState) -> FloatArray:
        """Return the gradient by theta of the model as the noise model sees it, shape (n_samples, n_theta).

        Both in scaled units.
        """
        return self.weighed(self._gradient(state))

    def _gradient(self, state: OutputErrorState) -> FloatArray:
        """Return the gradient by theta of the model, unweighed."""
        result = np.zeros((len(self.values), len(state.theta)))
        for k, (path, response) in enumerate(zip(self.paths, state.responses, strict=True)):
            # (T.8) by the denominators: paths that share one add up.
            result[:, self.parts[path.block]] += self._by_denominator(
                response, self.numerator(state, k), path.block
            )
        n_drifts = self.n_nuisances - self.n_a
        for record, (part, responses) in enumerate(zip(self.rows, state.free, strict=False)):
            place = self.n_numerators + record * self.n_nuisances + n_drifts
            for block, response in enumerate(responses):
                ascending = state.coefficients[place : place + self.orders[block]]
                # Free motions are B/A driven by an impulse: their derivative has the same form.
                result[part][:, self.parts[block]] += self._by_denominator(response, ascending, block)
                place += self.orders[block]
        for column, k in enumerate(self.free_delays):
            ascending = self.numerator(state, k)
            # (T.8) by a delay: a later input is the response's derivative by time, with the opposite sign.
            derivative = np.concatenate([[0.0], ascending])[None]  # s B / A: by time, in units of 1/scale
            result[:, self.n_a + column] = -self.scale * state.responses[k].combined(derivative)[:, 0]
        return result

    def _by_denominator(self, response: Response, ascending: FloatArray, block: int) -> FloatArray:
        """Return d/da_i of B/A with a_i at s^(n-i): -s^(n-i) B / A^2."""
        n = self.orders[block]
        products = np.zeros((n, n - 1 + len(ascending)))
        for i in range(n):
            products[i, n - 1 - i : n - 1 - i + len(ascending)] = -ascending
        return response.combined(products, squared=True)

    def _information(self, state: OutputErrorState, jacobian: FloatArray, variance: float) -> FloatArray:
        """Return the information on theta with the linear parameters unknown, prior knowledge included."""
        assert state.solution is not None
        # H of (T.10), with the priors as observations of their own.
        projected = state.solution.left_of(jacobian)
        information = projected.T @ projected / max(variance, 1e-300)
        for column, k in enumerate(self.free_delays):
            information[self.n_a + column, self.n_a + column] += 1.0 / self.paths[k].delay.sd ** 2
        return np.asarray(information)

    def slope(self, state: OutputErrorState) -> tuple[FloatArray, FloatArray]:
        """Return information matrix and descent direction."""
        variance = (float(state.residuals @ state.residuals) + self.floor) / len(self.values)
        jacobian = self.jacobian(state)
        # Minus the gradient of (T.9). The projector is not needed: residuals stand at right angles to Q.
        direction = jacobian.T @ state.residuals / variance
        for column, k in enumerate(self.free_delays):
            prior, place = self.paths[k].delay, self.n_a + column
            direction[place] += (prior.mean - state.theta[place]) / prior.sd**2
        return self._information(state, jacobian, variance), direction

    def initial_motion(self, state: OutputErrorState) -> Tested:
        """Return what ``ScoreTest.of`` needs of a state without free motion, to find whether there is some."""
        motions = []
        for own in self.experiments:
            free = [own.free(upper, state.scale, slopes=False) for upper in state.uppers]
            motions.append(np.concatenate([one.combined(np.eye(one.order)) for one in free], axis=1))
        return self._tested(state, block_diag(*motions))

    def followed_inputs(self, state: OutputErrorState) -> Tested:
        """Return what ``ScoreTest.of`` needs to find whether what a state leaves still follows the inputs."""
        lags = self.period * np.arange(_LAGS)
        lagged = [
            [
                path.seen(own.times, own.exposure, delay + lag)
                for path, delay in zip(own.paths, self.delays(state.theta), strict=True)
                for lag in lags
            ]
            for own in self.experiments
        ]
        return self._tested(state, np.concatenate([np.stack(own, axis=1) for own in lagged]))

    def _tested(self, state: OutputErrorState, left_out: FloatArray) -> Tested:
        """Return what ``ScoreTest.of`` needs of a state, and of columns that it may lack."""
        plain = self.under(None)
        plain.scale = state.scale
        if not state.responses or not state.responses[0].has_squares:
            state = plain.state(state.theta)
        if not state.responses:  # the point is not allowed: there is nothing to test
            nothing = np.zeros((len(self.values), 0))
            return nothing, LinearSolution.of(nothing), self.values, self.values
        present = np.concatenate([plain.jacobian(state), state.matrix], axis=1)
        return left_out, LinearSolution.of(present), self.unweighed_residuals(state), self.values

    def limited(self, theta: FloatArray, step: FloatArray) -> FloatArray:
        """Return where a step leads; a delay moves by one sampling period at most.

        Coefficients of a stable denominator are positive. At that bound a pole stands at zero, as where an integrator
        or an offset lacks, and the others move on without it.
        """
        candidate = theta + step
        candidate[self.n_a :] = theta[self.n_a :] + np.clip(step[self.n_a :], -self.period, self.period)
        own = theta[: self.n_a]
        candidate[: self.n_a] = np.maximum(candidate[: self.n_a], np.minimum(own, _MIN_POLE))
        return np.asarray(candidate)

    def spread(self, state: OutputErrorState) -> float:
        """Return the standard deviation of the residuals as the noise model sees them, free samples counted."""
        n_all = len(state.theta) + len(state.coefficients)
        power = float(state.residuals @ state.residuals) / max(len(self.values) - n_all, 1)
        return math.sqrt(power * (1.0 if self.noise is None else self.noise.inflation))

    def covariance(self, state: OutputErrorState, also: FloatArray | None = None) -> JointCovariance:
        """Return the joint covariance of theta and the linear coefficients at an optimum.

        Parameters
        ----------
        state : OutputErrorState
        also : ndarray or None, shape (n_theta, n_theta) -- information on theta from elsewhere
        """
        assert state.solution is not None
        variance = self.spread(state) ** 2
        jacobian = self.jacobian(state)
        information = self._information(state, jacobian, variance)
        if also is not None:
            information = information + also
        # G of (T.10): how the best linear coefficients move with theta.
        sensitivity = -state.solution.coefficients(jacobian)
        # Unit diagonal before the inverse: coefficients of different powers differ by orders of magnitude.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * np.outer(scale, scale)
        condition = float(np.linalg.cond(scaled))
        of_theta = np.linalg.pinv(scaled, rcond=1e-15, hermitian=True) * np.outer(scale, scale)
        cross = of_theta @ sensitivity.T
        of_linear = variance * state.solution.inverse_gram() + sensitivity @ cross
        values = np.block([[of_theta, cross], [cross.T, of_linear]])
        if self.noise is None or self.noise.is_plain or self.noise.is_rounded:
            values = self._under_colour(state, jacobian, variance, values)
        return JointCovariance(values, variance, condition)

    def _under_colour(
        self, state: OutputErrorState, jacobian: FloatArray, variance: float, covariance: FloatArray
    ) -> FloatArray:
        """Return the covariance of equal weights under the colour that the noise has: the sandwich (T.17)."""
        shown, is_rounded = self._noise_shown(state), self.noise is not None and self.noise.is_rounded
        if shown is not None and shown.is_plain:
            return covariance
        plain = self.unweighed_residuals(state)
        left = state.residuals if is_rounded else plain
        excess = np.zeros_like(covariance)
        design: FloatArray | None = None
        for k, (part, own) in enumerate(zip(self.rows, self.experiments, strict=True)):
            if are_rounding(own.values, plain[part]):
                continue
            seen = None if shown is None or shown.noises is None else shown.noises[k]
            if seen is None or seen.kept is not None or seen.follows:
                colour = colour_of(left[part], own.times)
            else:
                colour = seen.colour
            if colour.n_parameters:
                if design is None:
                    design = np.concatenate([jacobian, self.weighed(state.matrix)], axis=1)
                rows = design[part]
                excess += (colour.score_covariance(rows) - rows.T @ rows) / max(variance, 1e-300)
        result = covariance + covariance @ excess @ covariance
        return np.asarray(0.5 * (result + result.T))


def _in_a_row(parts: Sequence[FloatArray]) -> FloatArray:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
