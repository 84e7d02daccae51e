"""Whether one pole describes each mode of an identified model: a test on every identification, at little cost.

A mode whose pole moved with its amplitude, lambda + d lambda(A), would answer by

    d y(t) = Re int exp(lambda (t - tau)) d lambda(|a|) a dtau,    a = y - i (y' + zeta omega y)/omega_d

more than the linear model, to first order; a is the mode's own motion with amplitude and phase. Three such answers,
to a frequency that goes with A^2 and to a damping that goes with A and with 1/A (a cubic spring, quadratic and dry
damping), are looked for in the residuals, beside all that the linear parameters could still take up: a score test
(Rao 1948). Its covariance is that of the scores of blocks of time, each of which counts alike, so that neither colour
nor noise that swells with the motion makes alarms of itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import fdtrc

from beam_ident.amplitude.measured_input import disturbances_of, noisy_band_hz
from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import require_signals
from beam_ident.data.records import TimeRecord, busiest_stretch
from beam_ident.modal.block_rows import ColumnBlock
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.modal_estimation.input_disturbance import DisturbanceFilter
from beam_ident.noise.input_noise import Smoothing
from beam_ident.numerics.blas_threads import on_one_thread
from beam_ident.summary import Summarised, SummaryPart

LEVEL = 0.05
_BLOCKS = 40
_MOST_SAMPLES = 40_000  # of an output in all records together
_LOW = 1.0 / 3.0  # of the largest amplitude: where the range begins over which changes are stated
_N_LAWS = 3
_MIN_SHARE = 1e-3  # of the residuals' variance, which the outputs' own noise has at least
_ROUNDS = 4  # in which the outputs' own noise is found


@dataclass(frozen=True)
class ModeLinearity:
    """How the pole of one mode changes with its amplitude.

    Attributes
    ----------
    number : int -- of the mode, from 1
    p_value : float -- how often a mode with one pole would seem to change as much
    largest : float -- amplitude at ``output_name`` [``unit``]
    frequency_change, frequency_change_sd : float
        Relative, from a third of the largest amplitude to the largest; to first order.
    damping_change, damping_change_sd : float
        Of the damping ratio, likewise.
    output_name, unit : str
    """

    number: int
    p_value: float
    largest: float
    frequency_change: float
    frequency_change_sd: float
    damping_change: float
    damping_change_sd: float
    output_name: str
    unit: str

    def __str__(self) -> str:
        chance = f"p = {self.p_value:.2g}" if self.p_value > 1e-9 else "p < 1e-9"
        return (
            f"mode {self.number} ({chance}): from {_LOW * self.largest:.2g} to {self.largest:.2g} {self.unit} of "
            f"{self.output_name} its frequency changes by {100.0 * self.frequency_change:+.2g} +- "
            f"{100.0 * self.frequency_change_sd:.1g} %, its damping ratio by {100.0 * self.damping_change:+.2g} +- "
            f"{100.0 * self.damping_change_sd:.1g} %"
        )


@dataclass(frozen=True, repr=False)
class Linearity(Summarised):
    """The verdict on the modes of one identification.

    Attributes
    ----------
    modes : tuple of ModeLinearity
    p_value : float -- of the mode that changes most clearly, with the number of modes counted in (Sidak 1967)
    """

    modes: tuple[ModeLinearity, ...]
    p_value: float

    def summary_parts(self) -> list[SummaryPart]:
        """Return the summary's tables and sentences."""
        return [self.verdict]

    @property
    def is_linear(self) -> bool:
        """Whether one pole describes every mode, at the level of 5 %."""
        return self.p_value > LEVEL

    @property
    def verdict(self) -> str:
        """The same in words, with how much a mode changes that does."""
        if self.is_linear:
            return f"one pole describes each mode at all amplitudes of the data (p = {self.p_value:.2g})"
        worst = min(self.modes, key=lambda mode: mode.p_value)
        return f"one pole does not describe {worst}"

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain numbers."""
        return {
            "is_linear": self.is_linear,
            "p_value": self.p_value,
            "verdict": self.verdict,
            "modes": [dict(vars(mode)) for mode in self.modes],
        }


@on_one_thread
def linearity(records: Sequence[TimeRecord], model: ModalModel) -> Linearity:
    """Test whether one pole describes each mode of a model in the records that it was identified from.

    Parameters
    ----------
    records : sequence of TimeRecord
        Of long ones the stretches in which their inputs move most are read.
    model : ModalModel

    Returns
    -------
    Linearity

    Raises
    ------
    EstimationError
        The records are not of this model, or hold an output that never changes.
    """
    require_signals(records)
    most = max(_MOST_SAMPLES // len(records), 2)
    stretches = [busiest_stretch(record, most) for record in records]
    structure = ModalStructure(model.structure)
    regression = ModalRegression(stretches, structure, model.input_names)
    band_hz = noisy_band_hz(regression, model)
    if band_hz is not None:
        regression = ModalRegression(stretches, structure, model.input_names, Smoothing(band_hz))
    blocks = regression.blocks(model.natural_frequencies, model.damping_ratios, model.clock, gradients=True)
    outputs = [
        _Output(regression, j, blocks[regression.block_of[j]], model) for j in range(regression.n_outputs)
    ]
    if band_hz is None:
        parts = [_Part([output], []) for output in outputs]
    else:
        parts = [_Part(outputs, _filters(regression, stretches, outputs, model, Smoothing(band_hz)))]
    modes = tuple(_tested(parts, mode) for mode in range(model.n_modes))
    smallest = min(mode.p_value for mode in modes)
    return Linearity(modes, -math.expm1(len(modes) * math.log1p(-min(smallest, 1.0 - 1e-16))))


def _filters(
    regression: ModalRegression,
    records: Sequence[TimeRecord],
    outputs: Sequence[_Output],
    model: ModalModel,
    smoothing: Smoothing,
) -> list[DisturbanceFilter]:
    """Return what takes the noise of every record's input out of its rows, the outputs' own noise found along."""
    disturbances = disturbances_of(regression, records, model, smoothing)
    alone = [_Part([output], []) for output in outputs]
    variances = np.array([part.noise_sd**2 for part in alone])
    least = _MIN_SHARE * variances
    filters: list[DisturbanceFilter] = []
    for _ in range(_ROUNDS):
        filters = [disturbance.filter(seen, variances) for disturbance, seen in disturbances]
        white = [part.residuals[:, None].copy() for part in alone]
        for one in filters:
            one.whiten(white)
        # Innovations have unit power where the outputs' own noise is right.
        variances = np.maximum(variances * [float(np.mean(np.square(own))) for own in white], least)
    return filters


class _Output:
    """One output, what the linear model could take up of it, and how it moves in each mode."""

    def __init__(self, regression: ModalRegression, j: int, block: ColumnBlock, model: ModalModel) -> None:
        self.name, self.unit = regression.output_names[j], regression.units[j]
        self.times, self.segments = regression.times[j], regression.segments[j]
        self.values = regression.values[j]
        self._block, self._model = block, model
        assert block.by_time is not None
        self._found, _, _, _ = np.linalg.lstsq(block.matrix, self.values, rcond=None)
        slopes = block.slopes(np.asarray(self._found), latency_is_free=True, rate_is_free=True)
        tangent = np.hstack([block.matrix, slopes])
        size = np.linalg.norm(tangent, axis=0)
        self.tangent = tangent / np.where(size > 0.0, size, 1.0)

    @property
    def instants(self) -> FloatArray:
        """Times that go on from record to record, shape (n_rows,)."""
        own = [1e9 * record + self.times[rows] for record, rows in self.segments]
        return np.concatenate(own or [np.zeros(0)])

    def motion(self, mode: int) -> ComplexArray:
        """Return amplitude and phase of one mode's own motion, shape (n_rows,)."""
        block, columns = self._block, self._block.mode_columns[mode]
        omega, zeta = self._model.natural_frequencies[mode], self._model.damping_ratios[mode]
        share = self._found[columns]
        y = block.matrix[:, columns] @ share
        assert block.by_time is not None
        speed = block.by_time[:, columns] @ share
        return np.asarray(y - 1j * (speed + zeta * omega * y) / (omega * math.sqrt(1.0 - zeta**2)))

    def answers(self, mode: int, motion: ComplexArray, largest: float) -> FloatArray:
        """Return the answers to the three laws, shape (n_rows, 3), for changes of 1 at the largest amplitude."""
        omega, zeta = self._model.natural_frequencies[mode], self._model.damping_ratios[mode]
        pole = omega * complex(-zeta, math.sqrt(1.0 - zeta**2))
        size = np.abs(motion) / largest
        phase = motion / np.maximum(np.abs(motion), 1e-300)
        causes = omega * np.stack([1j * size**2 * motion, -size * motion, -largest * phase], axis=1)
        result = np.zeros((len(motion), _N_LAWS))
        for _, rows in self.segments:
            result[rows] = driven(pole, self.times[rows], causes[rows]).real
        return result


class _Part:
    """Outputs whose noise is independent of that of all others, behind the filters, and what they could take up."""

    def __init__(self, outputs: Sequence[_Output], filters: Sequence[DisturbanceFilter]) -> None:
        self.outputs, self._filters = outputs, filters
        self.instants = np.concatenate([output.instants for output in outputs])
        ends = np.cumsum([0, *(output.tangent.shape[1] for output in outputs)])
        tangents = [np.zeros((len(output.values), ends[-1])) for output in outputs]
        for own, output, begin, end in zip(tangents, outputs, ends, ends[1:], strict=False):
            own[:, begin:end] = output.tangent
        U, s, _ = np.linalg.svd(self._passed(tangents), full_matrices=False)
        self.known = U[:, s > 1e-9 * s[0]]
        self.residuals = self.rest([output.values[:, None] for output in outputs])[:, 0]
        free = max(len(self.instants) - self.known.shape[1], 1)
        self.noise_sd = float(np.linalg.norm(self.residuals)) / math.sqrt(free)

    def _passed(self, columns: Sequence[FloatArray]) -> FloatArray:
        passed = [own.copy() for own in columns]
        for one in self._filters:
            one.whiten(passed)
        return np.concatenate(passed)

    def rest(self, columns: Sequence[FloatArray]) -> FloatArray:
        """Return what no linear parameter explains of the same quantities for every output, one under the other."""
        values = self._passed(columns)
        return np.asarray(values - self.known @ (self.known.T @ values))


def driven(pole: complex, times: FloatArray, causes: ComplexArray) -> ComplexArray:
    """Return int exp(pole (t - tau)) cause(tau) dtau from the first instant on, shape (n, n_causes).

    Parameters
    ----------
    pole : complex -- [rad/s]
    times : ndarray, shape (n,) -- rising [s]
    causes : ndarray of complex, shape (n, n_causes)
        What turns as the pole does: the rule of trapezoids is taken in the frame that turns along.
    """
    steps = np.diff(times)
    turns = np.exp(pole * steps)
    # The sum runs over what each step adds, all brought to the end of its step.
    added = 0.5 * steps[:, None] * (turns[:, None] * causes[:-1] + causes[1:])
    result = np.zeros_like(causes)
    now = np.zeros(causes.shape[1], dtype=np.complex128)
    for k, turn in enumerate(turns):
        now = turn * now + added[k]
        result[k + 1] = now
    return result


def _tested(parts: Sequence[_Part], mode: int) -> ModeLinearity:
    """Return the test of one mode."""
    outputs = [output for part in parts for output in part.outputs]
    noise = [part.noise_sd for part in parts for _ in part.outputs]
    answers, largest = [], []
    for part in parts:
        motions = [output.motion(mode) for output in part.outputs]
        own = [float(np.max(np.abs(motion))) for motion in motions]
        raw = [
            output.answers(mode, motion, max(most, 1e-300))
            for output, motion, most in zip(part.outputs, motions, own, strict=True)
        ]
        answers.append(part.rest(raw) / part.noise_sd)
        largest += own
    reference = int(np.argmax(np.array(largest) / noise))
    numbers = _equal_blocks(parts, answers)
    normal, scores = np.zeros((_N_LAWS, _N_LAWS)), np.zeros((_BLOCKS, _N_LAWS))
    for part, X, own_blocks in zip(parts, answers, numbers, strict=True):
        normal += X.T @ X
        for law in range(_N_LAWS):
            weighed = X[:, law] * part.residuals / part.noise_sd
            scores[:, law] += np.bincount(own_blocks, weighed, minlength=_BLOCKS)
    restored = scores @ _restored(normal, parts, answers, numbers)
    # Of laws that the amplitudes of these data do not tell apart, one direction is tested.
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    sizes, directions = np.linalg.eigh(normal / np.outer(scale, scale))
    kept = directions[:, sizes > 1e-6] / scale[:, None]
    p_value = _p_value(scores.sum(axis=0) @ kept, restored @ kept)
    estimator = kept @ np.linalg.inv(kept.T @ normal @ kept) @ kept.T
    laws = estimator @ scores.sum(axis=0)
    covariance = estimator @ (restored.T @ restored) @ estimator
    of_frequency = np.array([1.0 - _LOW**2, 0.0, 0.0])
    of_damping = np.array([0.0, 1.0 - _LOW, 1.0 - 1.0 / _LOW])
    sds = [math.sqrt(max(float(row @ covariance @ row), 0.0)) for row in (of_frequency, of_damping)]
    return ModeLinearity(
        mode + 1,
        p_value,
        largest[reference],
        float(of_frequency @ laws),
        sds[0],
        float(of_damping @ laws),
        sds[1],
        outputs[reference].name,
        outputs[reference].unit,
    )


def _equal_blocks(parts: Sequence[_Part], answers: Sequence[FloatArray]) -> list[IndexArray]:
    """Return the block of time to which every sample of every part belongs, all with as much of the answers."""
    weights = [np.sum(X**2 / np.maximum(np.sum(X**2, axis=0), 1e-300), axis=1) for X in answers]
    every, weight = np.concatenate([part.instants for part in parts]), np.concatenate(weights)
    order = np.argsort(every, kind="stable")
    share = np.cumsum(weight[order])
    share /= max(float(share[-1]), 1e-300)
    edges = every[order][np.searchsorted(share, np.arange(1, _BLOCKS) / _BLOCKS)]
    return [np.searchsorted(edges, part.instants, side="left") for part in parts]


def _restored(
    normal: FloatArray, parts: Sequence[_Part], answers: Sequence[FloatArray], numbers: Sequence[IndexArray]
) -> FloatArray:
    """Return what gives the scores of blocks the spread that white noise has, shape (3, 3).

    The linear parameters have taken some of the noise out of every block, (I - H) of it: the scores spread by
    X^T (I - H) X within the blocks, where their sum spreads by X^T X.
    """
    within = normal.copy()
    for part, X, own in zip(parts, answers, numbers, strict=True):
        for block in range(_BLOCKS):
            rows = own == block
            shared = X[rows].T @ part.known[rows]
            within -= shared @ shared.T
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    roots = []
    for matrix, power in ((within, -0.5), (normal, 0.5)):
        sizes, V = np.linalg.eigh(matrix / np.outer(scale, scale))
        roots.append((V * np.maximum(sizes, 1e-9) ** power) @ V.T)
    return np.asarray((roots[0] @ roots[1]) * scale / scale[:, None])


def _p_value(total: FloatArray, scores: FloatArray) -> float:
    """Return how often blocks of scores about zero would lie as far from it together (Hotelling 1931)."""
    n, m = scores.shape
    spread = scores.T @ scores
    found = float(total @ np.linalg.solve(spread, total))  # at most n
    if found >= n:  # all blocks alike
        return 0.0
    return float(fdtrc(m, n - m, (n - m) / m * found / (n - found)))
