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

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.data.argument_checks import require_signals
from beam_ident.data.records import TimeRecord, busiest_stretch
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ColumnBlock, ModalRegression
from beam_ident.modal.structure import ModalStructure
from beam_ident.numerics.blas_threads import on_one_thread

LEVEL = 0.05
_BLOCKS = 40
_MOST_SAMPLES = 40_000  # of an output in all records together
_LOW = 1.0 / 3.0  # of the largest amplitude: where the range begins over which changes are stated
_N_LAWS = 3


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


@dataclass(frozen=True)
class Linearity:
    """The verdict on the modes of one identification.

    Attributes
    ----------
    modes : tuple of ModeLinearity
    p_value : float -- of the mode that changes most clearly, with the number of modes counted in (Sidak 1967)
    """

    modes: tuple[ModeLinearity, ...]
    p_value: float

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
    regression = ModalRegression(
        [busiest_stretch(record, most) for record in records],
        ModalStructure(model.structure),
        model.input_names,
    )
    blocks = regression.blocks(model.natural_frequencies, model.damping_ratios, model.clock, gradients=True)
    outputs = [
        _Output(regression, j, blocks[regression.block_of[j]], model) for j in range(regression.n_outputs)
    ]
    modes = tuple(_tested(outputs, mode, model) for mode in range(model.n_modes))
    smallest = min(mode.p_value for mode in modes)
    return Linearity(modes, -math.expm1(len(modes) * math.log1p(-min(smallest, 1.0 - 1e-16))))


class _Output:
    """What the linear model leaves of one output, and what it could still take up."""

    def __init__(self, regression: ModalRegression, j: int, block: ColumnBlock, model: ModalModel) -> None:
        self.name, self.unit = regression.output_names[j], regression.units[j]
        self.times, self.segments = regression.times[j], regression.segments[j]
        self._block, self._model = block, model
        assert block.by_time is not None
        self._found, _, _, _ = np.linalg.lstsq(block.matrix, regression.values[j], rcond=None)
        slopes = block.slopes(np.asarray(self._found), latency_is_free=True, rate_is_free=True)
        tangent = np.hstack([block.matrix, slopes])
        size = np.linalg.norm(tangent, axis=0)
        U, s, _ = np.linalg.svd(tangent / np.where(size > 0.0, size, 1.0), full_matrices=False)
        self.known = U[:, s > 1e-9 * s[0]]
        self.residuals = self.rest(regression.values[j])
        free = max(len(self.times) - self.known.shape[1], 1)
        self.noise_sd = float(np.linalg.norm(self.residuals)) / math.sqrt(free)

    def rest(self, values: FloatArray) -> FloatArray:
        """Return what no linear parameter explains."""
        return np.asarray(values - self.known @ (self.known.T @ values))

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


def _tested(outputs: Sequence[_Output], mode: int, model: ModalModel) -> ModeLinearity:
    """Return the test of one mode."""
    motions = [output.motion(mode) for output in outputs]
    largest = [float(np.max(np.abs(motion))) for motion in motions]
    reference = int(np.argmax(np.array(largest) / [output.noise_sd for output in outputs]))
    parts = []
    for output, motion, most in zip(outputs, motions, largest, strict=True):
        raw = output.answers(mode, motion, max(most, 1e-300))
        parts.append(np.stack([output.rest(raw[:, k]) for k in range(_N_LAWS)], axis=1) / output.noise_sd)
    numbers = _equal_blocks(outputs, parts)
    normal, scores = np.zeros((_N_LAWS, _N_LAWS)), np.zeros((_BLOCKS, _N_LAWS))
    for output, X, own in zip(outputs, parts, numbers, strict=True):
        normal += X.T @ X
        for law in range(_N_LAWS):
            weighed = X[:, law] * output.residuals / output.noise_sd
            scores[:, law] += np.bincount(own, weighed, minlength=_BLOCKS)
    restored = scores @ _restored(normal, outputs, parts, numbers)
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


def _equal_blocks(outputs: Sequence[_Output], parts: Sequence[FloatArray]) -> list[IndexArray]:
    """Return the block of time to which every sample of every output belongs, all with as much of the answers."""
    keys = [
        np.concatenate(
            [1e9 * record + output.times[rows] for record, rows in output.segments] or [np.zeros(0)]
        )
        for output in outputs
    ]
    weights = [np.sum(X**2 / np.maximum(np.sum(X**2, axis=0), 1e-300), axis=1) for X in parts]
    every, weight = np.concatenate(keys), np.concatenate(weights)
    order = np.argsort(every, kind="stable")
    share = np.cumsum(weight[order])
    share /= max(float(share[-1]), 1e-300)
    edges = every[order][np.searchsorted(share, np.arange(1, _BLOCKS) / _BLOCKS)]
    return [np.searchsorted(edges, key, side="left") for key in keys]


def _restored(
    normal: FloatArray,
    outputs: Sequence[_Output],
    parts: Sequence[FloatArray],
    numbers: Sequence[IndexArray],
) -> FloatArray:
    """Return what gives the scores of blocks the spread that white noise has, shape (3, 3).

    The linear parameters have taken some of the noise out of every block, (I - H) of it: the scores spread by
    X^T (I - H) X within the blocks, where their sum spreads by X^T X.
    """
    within = normal.copy()
    for output, X, own in zip(outputs, parts, numbers, strict=True):
        for block in range(_BLOCKS):
            rows = own == block
            shared = X[rows].T @ output.known[rows]
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
