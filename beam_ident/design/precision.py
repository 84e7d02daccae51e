"""How well a record can tell the parameters of a known model, before anything is fitted: the Cramer-Rao bound.

Of a record that is there (``predicted_precision``), gains, residues and drifts of every output are what the record
itself says at these poles; poles, latency and the clock's rate are the unknowns that remain. What is asked is the
record's information, not the poles: they need only be about right. Of a record that is not there yet
(``predicted_model``), a model says what would be seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from beam_ident.arrays import FloatArray
from beam_ident.data.bandwidth import excited_band
from beam_ident.data.records import InputSignal, OutputSignal, TimeRecord
from beam_ident.errors import ExcitationError
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.structure import ModalStructure, StructureKind
from beam_ident.modal_estimation.input_disturbance import InputDisturbance, Observations
from beam_ident.noise.input_noise import Smoothing

if TYPE_CHECKING:
    from beam_ident.modal.model import ModalModel

_STANDS_OUT = 3.0  # standard deviations of a residue: once in 370 by chance


@dataclass(frozen=True, eq=False)
class PredictedPrecision:
    """What a record can tell of poles.

    Attributes
    ----------
    omegas, zetas : ndarray, shape (n_modes,) -- natural frequencies [rad/s] and damping ratios that were assumed
    omega_sd, zeta_sd : ndarray, shape (n_modes,)
        Standard deviations that the best estimator would have; infinite where the record tells nothing.
    """

    omegas: FloatArray
    zetas: FloatArray
    omega_sd: FloatArray
    zeta_sd: FloatArray


def predicted_precision(
    records: Sequence[TimeRecord],
    structure: StructureKind,
    omegas: ArrayLike,
    zetas: ArrayLike,
    noise_sd: Mapping[str, float],
    clock_rate_sd: float = 0.0,
) -> PredictedPrecision:
    """Return how well records can tell poles that are about known.

    Parameters
    ----------
    records : sequence of TimeRecord -- of one system
    structure : str -- which model goes with the input, as in ``identify``
    omegas : array_like, shape (n_modes,) -- natural frequencies [rad/s]
    zetas : array_like, shape (n_modes,) -- damping ratios
    noise_sd : mapping -- standard deviation of the white noise of every output, by its name
    clock_rate_sd : float -- how well the rate of the outputs' clock against the input's is known beforehand

    Raises
    ------
    EstimationError
        Records that ``identify`` would refuse as well.
    """
    omegas, zetas = (np.asarray(values, dtype=np.float64) for values in (omegas, zetas))
    regression = ModalRegression(records, ModalStructure(structure))
    blocks = regression.blocks(omegas, zetas, ClockState(), gradients=True)
    n = len(omegas)
    has_rate = clock_rate_sd > 0.0
    information = np.zeros((2 * n + 1 + has_rate, 2 * n + 1 + has_rate))
    for j, name in enumerate(regression.output_names):
        block = blocks[regression.block_of[j]]
        size = np.linalg.norm(block.matrix, axis=0)
        size = np.where(size > 0.0, size, 1.0)
        basis, values, axes = np.linalg.svd(block.matrix / size, full_matrices=False)
        kept = values > 1e-10 * values[0]
        basis, axes = basis[:, kept], axes[kept] / values[kept, None]
        found = axes.T @ (basis.T @ regression.values[j])
        # A residue that does not stand out of the noise is none: it would tell of poles that nothing shows.
        sd = noise_sd[name] * np.sqrt(np.sum(np.square(axes), axis=0))
        of_modes = np.unique(block.mode_columns)
        found[of_modes] = np.where(np.abs(found) > _STANDS_OUT * sd, found, 0.0)[of_modes]
        slopes = block.slopes(found / size, True, has_rate)
        # What gains, residues and drifts can take over tells nothing of the poles.
        slopes = (slopes - basis @ (basis.T @ slopes)) / noise_sd[name]
        information += slopes.T @ slopes
    if has_rate:
        information[-1, -1] += 1.0 / clock_rate_sd**2
    scale = np.sqrt(np.diag(information))
    is_seen = scale > 0.0
    sd = np.full(len(information), np.inf)
    if np.any(is_seen):
        part = information[np.ix_(is_seen, is_seen)] / np.outer(scale[is_seen], scale[is_seen])
        bound = np.sqrt(np.maximum(np.diag(np.linalg.pinv(part, hermitian=True)), 0.0))
        sd[is_seen] = bound / scale[is_seen]
    return PredictedPrecision(omegas, zetas, sd[:n] * omegas, sd[n : 2 * n])


@dataclass(frozen=True)
class Observation:
    """How the input and the outputs of an experiment will be seen.

    Parameters
    ----------
    rate_hz : float -- of the camera [frames/s]
    noise_sd : mapping of str to float -- standard deviation of the white noise of every output, by its name
    exposure_s : float -- over which a frame averages [s]
    latency_sd : float -- how well the stamps' latency is known beforehand [s]; infinite: not at all
    clock_rate_sd : float -- how well the clock's rate against the input's is known beforehand
    input_sd : float
        Standard deviation of the white noise of the measured input, in its unit: of an encoder 0.29 of its step.

    Raises
    ------
    ExcitationError
        A number out of its range.
    """

    rate_hz: float
    noise_sd: Mapping[str, float]
    exposure_s: float = 0.0
    latency_sd: float = math.inf
    clock_rate_sd: float = 50e-6
    input_sd: float = 0.0

    def __post_init__(self) -> None:
        numbers = {"rate_hz": self.rate_hz, **{f"noise_sd of {k}": sd for k, sd in self.noise_sd.items()}}
        for name, value in numbers.items():
            if not (math.isfinite(value) and value > 0.0):
                raise ExcitationError(f"observation: {name} is {value!r}; expected a finite number > 0")
        for name in ("exposure_s", "latency_sd", "clock_rate_sd", "input_sd"):
            if not getattr(self, name) >= 0.0:
                raise ExcitationError(
                    f"observation: {name} is {getattr(self, name)!r}; expected a number >= 0"
                )
        if self.exposure_s * self.rate_hz > 1.0 + 1e-6:
            raise ExcitationError(
                f"observation: exposure_s is {self.exposure_s!r}; expected at most {1.0 / self.rate_hz:.4g} s, from "
                f"one frame to the next at {self.rate_hz:g} Hz: give it in seconds"
            )

    def noise_of(self, names: Sequence[str]) -> FloatArray:
        """Return the standard deviations of some outputs, shape (n_outputs,).

        Raises
        ------
        ExcitationError
            One of them has none.
        """
        missing = [name for name in names if name not in self.noise_sd]
        if missing:
            raise ExcitationError(
                f"observation: noise_sd names no {', '.join(missing)}; expected one of every output: "
                f"{', '.join(names)}"
            )
        return np.array([self.noise_sd[name] for name in names], dtype=np.float64)

    def stamps(self, duration_s: float) -> FloatArray:
        """Return when frames are taken that lie within a record from 0 to ``duration_s`` [s]."""
        half = 0.5 * self.exposure_s
        first = max(1, math.ceil(half * self.rate_hz))
        last = math.floor((duration_s - half) * self.rate_hz)
        return np.asarray(np.arange(first, last) / self.rate_hz, dtype=np.float64)


def predicted_model(model: ModalModel, drive: InputSignal, observation: Observation) -> ModalModel:
    """Return the model with the covariance that the best estimator would have after an experiment.

    Parameters
    ----------
    model : ModalModel -- of one input; what is taken for true
    drive : InputSignal -- of the kind that its structure names, from 0 s
    observation : Observation

    Raises
    ------
    ExcitationError
        Fewer frames than the model has parameters; an output without noise.

    Notes
    -----
    Every output has the unknowns of ``identify``: gain, residual term and residues, and for the record an offset, a
    ramp and motion at the beginning; all share log omega, zeta, latency and rate. The information is that of the
    model's slopes J by all of these, ``J' Sigma^-1 J``. Sigma is the outputs' noise, and what the input's noise adds
    through the modes: near a resonance coloured, and common to all outputs.
    """
    structure = ModalStructure(model.structure)
    times = observation.stamps(drive.span_s[1])
    n, shared = model.n_modes, model.column_parameters()
    if len(times) < shared.shape[1] + 2 * n + 2:
        raise ExcitationError(
            f"{len(times)} frames for {shared.shape[1] + 2 * n} parameters; expected more: film faster or longer"
        )
    # Enough values for a record; what is seen comes from the model itself.
    blank = np.zeros(len(times))
    outputs = tuple(
        OutputSignal(name, "", times, blank, observation.exposure_s) for name in model.output_names
    )
    regression = ModalRegression([TimeRecord((drive,), outputs)], structure)
    omegas, zetas = model.natural_frequencies, model.damping_ratios
    (block,) = regression.blocks(omegas, zetas, ClockState(), gradients=True)
    noise, n_common, width = observation.noise_of(model.output_names), 2 * n + 2, block.matrix.shape[1]
    slopes = []
    for j, parameters in enumerate(shared):
        found = np.zeros(width)
        found[: len(parameters)] = parameters
        own = np.zeros((len(times), n_common + len(shared) * width))
        own[:, :n_common] = block.slopes(found, True, True)
        own[:, n_common + j * width : n_common + (j + 1) * width] = block.matrix
        slopes.append(own)
    _whiten(slopes, regression, model, observation)
    information = np.sum([own.T @ own for own in slopes], axis=0)
    for place, sd in enumerate((observation.latency_sd, observation.clock_rate_sd), 2 * n):
        information[place, place] += 1.0 / max(sd, 1e-12) ** 2 if math.isfinite(sd) else 0.0
    first = 0 if structure.has_direct else 1
    # Among all that is estimated, and among the model's own.
    estimated, places = ([*range(n_common)] for _ in range(2))
    for j in range(len(outputs)):
        estimated += [n_common + j * width + k for k in range(n + 2 - first)]
        places += [n_common + j * (n + 2) + k for k in range(first, n + 2)]
    scale = np.concatenate([omegas, np.ones(len(places) - n)])
    result = np.zeros_like(model.covariance)
    full = _inverse(information)[np.ix_(estimated, estimated)]
    result[np.ix_(places, places)] = full * np.outer(scale, scale)
    return replace(model, covariance=result, noise_sd=noise)


def _whiten(
    slopes: list[FloatArray], regression: ModalRegression, model: ModalModel, observation: Observation
) -> None:
    """Divide the outputs' rows by the root of their noise's covariance, in place."""
    noise = observation.noise_of(model.output_names)
    if observation.input_sd == 0.0:
        for own, sd in zip(slopes, noise, strict=True):
            own /= sd
        return
    structure, drive = regression.structure, replace(regression.drives[0], sigma=observation.input_sd)
    band = excited_band(drive, structure.driving_power, regression.duration_s, regression.rate_hz)
    disturbance = InputDisturbance(
        drive,
        structure,
        model.natural_frequencies,
        model.damping_ratios,
        model.column_parameters(),
        np.full(len(noise), observation.exposure_s),
        Smoothing(band.high_hz),
    )
    disturbance.filter(Observations.of_record(regression, 0, 0.0), np.square(noise)).whiten(slopes)


def _inverse(information: FloatArray) -> FloatArray:
    """Return the covariance, very large in the directions of which nothing is known."""
    diagonal = np.diag(information)
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    values, axes = np.linalg.eigh(information / np.outer(scale, scale))
    axes = axes / scale[:, None]
    return np.asarray((axes / np.maximum(values, 1e-13)) @ axes.T)
