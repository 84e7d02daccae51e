"""Amplitudes and phases of lines, refined together on the record as it will be: from rest, of finite length.

The convex design (``design.spectrum``) knows lines in their steady state and effective values. In a record that a
lightly damped mode outlasts nothing is steady, and what limits is a peak: of the travel, or of a tip that rings up
while the travel is still small. Here everything is linear in the lines' sines and cosines x: what the camera sees,
its slopes by all parameters, and every limited quantity. So

    log variance( J(x)' J(x) ) + 2 log max_qt | Q_qt x |

is smooth but for the maximum, which L_p norms approach, and does not change with the level of x. Its minimum is the
best design on these lines at the largest level that the limits allow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.design.criteria import Criterion
from beam_ident.design.limits import ExcitationLimits
from beam_ident.design.precision import Observation
from beam_ident.design.spectrum import left_by_input_noise
from beam_ident.excitation.multisine import ShapedMultisine
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure
from beam_ident.numerics.pole_response import recursion

_NORMS = (8, 16, 32, 64)
_ITERATIONS = 40
_INSTANTS = 16384  # of each limited quantity at most; the level is found from all
_IN_A_PERIOD = 5.0  # instants of the fastest line: between fewer, refined peaks hide
_FRAMES = 500  # that stand for all of a long record
_PLACE_SEED = 1
_FAINT = 1e-3  # of the largest acceleration and of the largest share in a limited quantity: a line below is left out


def _chosen(places: IndexArray, most: int) -> IndexArray:
    """Return some of many places, at random: a regular grid would miss the peaks of lines that it folds."""
    if len(places) <= most:
        return places
    return np.sort(np.random.default_rng(_PLACE_SEED).choice(places, most, replace=False))


def _quadratures(recipe: ShapedMultisine, period_s: float) -> list[FloatArray]:
    """Return the accelerations of the sine of every line, of effective value 1 m/s^2, then those of every cosine."""
    return [
        ShapedMultisine((frequency,), (1.0,), (phase,), 1.0, recipe.duration, recipe.fade, recipe.still)
        .sample(period_s)
        .accelerations
        for phase in (0.0, 0.5 * math.pi)
        for frequency in recipe.frequencies
    ]


class SeenLines:
    """What every line by itself does to the outputs at the frames, and to their slopes by all parameters.

    Parameters
    ----------
    model : ModalModel
    recipe : ShapedMultisine -- its amplitudes and phases do not matter
    limits : ExcitationLimits -- gives the drive's scale and the hold
    observation : Observation

    Notes
    -----
    Outputs share their frames, so that the slopes of all of them are combinations of few signals: of every mode its
    coordinate, that by log omega and by log zeta, its rate, and its rate times t; of the base its position, velocity,
    velocity times t, and the drive. Offset, ramp and the modes' free motion are taken out of each. An exposure and
    the input's noise weaken every line by its own factor.
    """

    def __init__(
        self, model: ModalModel, recipe: ShapedMultisine, limits: ExcitationLimits, observation: Observation
    ) -> None:
        period = limits.period_s
        frames = np.rint(observation.stamps(recipe.total_s) / period).astype(np.intp)
        at = _chosen(frames, _FRAMES)
        times = period * at
        late = np.asarray(times - 0.5 * recipe.total_s, dtype=np.float64)
        free = np.exp(np.outer(times, model.poles))
        nuisance = np.column_stack([np.ones(len(at)), late, free.real, free.imag])
        frame = np.linalg.qr(nuisance / np.linalg.norm(nuisance, axis=0))[0]
        lines = np.array(recipe.frequencies)
        blur = np.sinc(lines * observation.exposure_s)
        if observation.input_sd:
            blur *= np.sqrt(left_by_input_noise(model, lines, limits, recipe.duration, observation))
        signals = []
        for values, weaker in zip(_quadratures(recipe, period), np.tile(blur, 2), strict=True):
            own = weaker * _signals(model, limits.scale * values, period, at, late)
            signals.append(own - frame @ (frame.T @ own))
        self._signals = math.sqrt(len(frames) / len(at)) * np.stack(signals, axis=-1)
        self._maps = _maps(model, observation)
        known = (observation.latency_sd == 0.0, observation.clock_rate_sd == 0.0)
        self._known = [2 * model.n_modes + k for k, is_known in enumerate(known) if is_known]

    def information(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the information of all parameters, and the signals that it is made of."""
        signals = self._signals @ x
        gram = signals.T @ signals
        total = np.einsum("jbp,bc,jcq->pq", self._maps, gram, self._maps, optimize=True)
        for place in self._known:
            total[place], total[:, place] = 0.0, 0.0
            total[place, place] = 1.0
        return total, signals

    def slopes(self, signals: FloatArray, weight: FloatArray) -> FloatArray:
        """Return the slopes by x of the sum of the information times a weight."""
        for place in self._known:
            weight[place], weight[:, place] = 0.0, 0.0
        pull = np.einsum("jbp,pq,jcq->bc", self._maps, weight, self._maps, optimize=True)
        return np.asarray(2.0 * (signals @ pull).ravel() @ self._signals.reshape(-1, self._signals.shape[2]))


def _signals(
    model: ModalModel, drive: FloatArray, period_s: float, at: IndexArray, late: FloatArray
) -> FloatArray:
    """Return the signals of ``SeenLines`` at some ticks under a held drive, shape (n_ticks, 5 n_modes + 4)."""
    power = (
        0 if ModalStructure(model.structure).is_motion else ModalStructure(model.structure).differentiations
    )
    velocities = np.concatenate([[0.0], np.cumsum(drive)])[:-1] * period_s
    positions = np.cumsum(velocities) * period_s + 0.5 * period_s * (velocities - velocities[0])
    of_base = [positions, velocities, drive, np.gradient(drive, period_s)]
    columns = []
    for omega, zeta in zip(model.natural_frequencies, model.damping_ratios, strict=True):
        root = math.sqrt(1.0 - zeta**2)
        pole = omega * complex(-zeta, root)
        slopes = pole, omega * zeta * complex(-1.0, -zeta / root)  # by log omega, by log zeta
        x, by_pole = _pole_responses(pole, drive, period_s)
        raised, rate = pole**power * x, pole ** (power + 1) * x
        by_raised = pole**power * by_pole + power * pole ** max(power - 1, 0) * x
        columns.append(raised.imag / pole.imag + (drive if power == 2 else 0.0))
        for slope in slopes:
            moved = (by_raised * slope).imag / pole.imag
            columns.append(moved - raised.imag * slope.imag / pole.imag**2)
        columns.append(rate.imag / pole.imag)
    columns += [of_base[power], of_base[power + 1], drive if power == 0 else np.zeros_like(drive)]
    own = np.stack([column[at] for column in columns], axis=1)
    rates = [*range(3, 4 * model.n_modes, 4), 4 * model.n_modes + 1]
    return np.concatenate([own, own[:, rates] * late[:, None]], axis=1)


def _pole_responses(pole: complex, drive: FloatArray, period_s: float) -> tuple[ComplexArray, ComplexArray]:
    """Return the response of 1 / (s - p) to a held drive at the ticks, and its slope by p."""
    step = np.exp(pole * period_s)
    gain = (step - 1.0) / pole
    by_gain = (period_s * step - gain) / pole
    x = recursion(np.array([step]), gain * drive, 0.0)[:-1]
    # x[k+1] = a x[k] + g u[k]: its slope follows the same recursion, driven by a' x[k] + g' u[k].
    return x, recursion(np.array([step]), period_s * step * x + by_gain * drive, 0.0)[:-1]


def _maps(model: ModalModel, observation: Observation) -> FloatArray:
    """Return how the parameters' slopes of every output are made of the signals, over its noise.

    Returns
    -------
    ndarray, shape (n_outputs, n_signals, n_parameters) -- parameters in the order of the model's names
    """
    structure = ModalStructure(model.structure)
    n, m = model.n_modes, len(model.output_names)
    result = np.zeros((m, 5 * n + 4, len(model.parameter_names)))
    direct = 1.0 if structure.has_direct else 0.0
    for j, name in enumerate(model.output_names):
        own = result[j]
        first = 2 * n + 2 + j * (n + 2)
        for k in range(n):
            residue = structure.sign * model.residues[j, k]
            own[4 * k, first + 2 + k] = structure.sign
            own[4 * k + 1, k] = own[4 * k + 2, n + k] = residue
            own[4 * k + 3, 2 * n] = own[4 * n + 3 + k, 2 * n + 1] = -residue
        gain = direct * model.gains[j]
        own[4 * n, first], own[4 * n + 2, first + 1] = direct, structure.sign
        own[4 * n + 1, 2 * n] = own[5 * n + 3, 2 * n + 1] = -gain
        own /= observation.noise_sd[name]
    return result


class LimitedLines:
    """What every line by itself does to the limited quantities of an experiment.

    Parameters
    ----------
    recipe : ShapedMultisine -- its amplitudes and phases do not matter
    limits : sequence of ExcitationLimits -- for the model, and for draws of it
    """

    def __init__(self, recipe: ShapedMultisine, limits: Sequence[ExcitationLimits]) -> None:
        rows, period = [], limits[0].period_s
        step = max(1, int(1.0 / (_IN_A_PERIOD * max(recipe.frequencies) * period)))
        for values in _quadratures(recipe, period):
            at = _chosen(np.arange(0, len(values), step), _INSTANTS)
            rows.append(np.concatenate([own.over_time(values)[:, at].ravel() for own in limits]))
        self._rows = np.stack(rows, axis=1).astype(np.float32)

    @property
    def sizes(self) -> FloatArray:
        """Peak of a line of effective value 1 m/s^2 over the limit that it comes closest to, shape (n_lines,)."""
        both = np.max(np.abs(self._rows), axis=0).astype(np.float64)
        return np.asarray(np.max(both.reshape(2, -1), axis=0))

    def log_peak(self, x: FloatArray, power: int) -> tuple[float, FloatArray]:
        """Return the logarithm of the L_p norm of all quantities over their limits, and its slopes by x."""
        values = (self._rows @ x.astype(np.float32)).astype(np.float64)
        peak = float(np.max(np.abs(values)))
        scaled = values / peak
        # Of p = 2^k: x^(p - 1) = x x^2 x^4 .., some ten times quicker than a power.
        lower, square = scaled.copy(), scaled
        for _ in range(power.bit_length() - 2):
            square = square * square
            lower *= square
        total = float(np.sum(lower * scaled))
        slopes = (lower / (total * peak)).astype(np.float32) @ self._rows
        return math.log(peak) + math.log(total / len(values)) / power, np.asarray(slopes, dtype=np.float64)


def refined(
    criteria: Sequence[tuple[float, Criterion, FloatArray]],
    seen: Sequence[SeenLines],
    limited: LimitedLines,
    start: FloatArray,
) -> FloatArray:
    """Return the lines' sines and cosines of the best design, at any level, shape (2 n_lines,).

    Parameters
    ----------
    criteria : sequence of tuple -- each with its share, and the combinations of parameters that count
    seen : sequence of SeenLines -- for the model, and for draws of it
    limited : LimitedLines
    start : ndarray, shape (2 n_lines,) -- sines, then cosines
    """

    def cost(x: FloatArray, power: int) -> tuple[float, FloatArray]:
        value, slopes = limited.log_peak(x, power)
        value, slopes = 2.0 * value, 2.0 * slopes
        for own in seen:
            information, signals = own.information(x)
            for share, criterion, interest in criteria:
                log_variance, weight = criterion.log_variance(information[None], interest)
                value += share * float(log_variance[0]) / len(seen)
                slopes -= share * own.slopes(signals, weight[0]) / len(seen)
        return value, slopes

    x = start / np.max(np.abs(start))
    for power in _NORMS:
        options = {"maxiter": _ITERATIONS, "gtol": 1e-9, "ftol": 1e-9}
        found = minimize(cost, x, args=(power,), jac=True, method="L-BFGS-B", options=options)
        x = np.asarray(found.x, dtype=np.float64)
        x /= np.max(np.abs(x))
    return np.asarray(x, dtype=np.float64)


def amplitudes_and_phases(x: FloatArray, limited: LimitedLines) -> tuple[FloatArray, FloatArray]:
    """Return the effective values and the phases [rad] of lines from their sines and cosines; faint ones are 0."""
    sines, cosines = np.split(x, 2)
    amplitudes = np.hypot(sines, cosines)
    # At a resonance little acceleration moves a tip far.
    moved = amplitudes * limited.sizes
    kept = (amplitudes > _FAINT * np.max(amplitudes)) | (moved > _FAINT * np.max(moved))
    return np.where(kept, amplitudes, 0.0), np.mod(np.arctan2(cosines, sines), 2.0 * np.pi)
