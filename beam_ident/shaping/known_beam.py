"""What is known of a beam on its axis before a move: modes with their covariance, and what no covariance holds.

An identification states how well it knows the modes of its own record. Later the strip is warmer, the axis lags
behind its command, the air takes hold of a beam that moves fast. Each of these is drawn beside the model's
parameters, so that what is predicted of a move has an interval that holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from beam_ident.amplitude.curves import AmplitudeCurves
from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.errors import EstimationError
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure

DRAWS = 2000
"""With so many, a probability of 5 % is known to 0.5 %."""
_MOST_DAMPING = 0.9
_LAW_SD = 0.1
"""Relative standard deviation of a law of free swings in a driven move: no single coefficient is that of a moving hub
and of a swinging beam."""


@dataclass(frozen=True)
class PoleDrift:
    """How far the modes may have moved since they were identified, beside the model's own covariance.

    Parameters
    ----------
    frequency_sd : float
        Relative, of each natural frequency: temperature, clocks, and a servo that yields to the beam.
    damping_sd : float
        Relative, of each damping ratio.
    """

    frequency_sd: float = 0.0
    damping_sd: float = 0.0

    def __post_init__(self) -> None:
        for name in ("frequency_sd", "damping_sd"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 <= value < 1.0):
                raise EstimationError(
                    f"drift: {name} is {value!r}; expected a relative standard deviation from 0 to 1"
                )


@dataclass(frozen=True)
class AxisErrors:
    """How the hub's true motion differs from its command, beside what is linear.

    Parameters
    ----------
    lag : float
        By how much dry friction holds the hub back behind its command while it moves [m].
    scatters : tuple of (float, float)
        Largest acceleration of a motion [m/s^2], and the standard deviation of all other deviations in it [m].
        Between them it is interpolated; a move that takes more than the largest is believed to scatter more, in
        proportion.
    before : float or None
        Direction of the motion before, as a sign: the hub still lags that way. None: not known.
    """

    lag: float = 0.0
    scatters: tuple[tuple[float, float], ...] = ()
    before: float | None = None

    def __post_init__(self) -> None:
        lengths = (self.lag, *(scatter for _, scatter in self.scatters))
        if not all(math.isfinite(length) and length >= 0.0 for length in lengths):
            raise EstimationError(f"axis: lag and scatters are {lengths} m; expected finite lengths >= 0")
        if not all(acceleration > 0.0 for acceleration, _ in self.scatters):
            raise EstimationError(
                f"axis: scatters are {self.scatters}; expected accelerations above 0 before them"
            )
        object.__setattr__(self, "scatters", tuple(sorted(self.scatters)))

    def scatter_at(self, acceleration: float) -> float:
        """Return the scatter of a move whose largest acceleration is this one [m]."""
        if not self.scatters:
            return 0.0
        accelerations, scatters = np.array(self.scatters).T
        beyond = max(1.0, acceleration / float(accelerations[-1]))
        return beyond * float(np.interp(acceleration, accelerations, scatters))

    @property
    def scatter_slope(self) -> float:
        """What an acceleration more adds to the scatter of a quick move [m per m/s^2]."""
        return self.scatters[-1][1] / self.scatters[-1][0] if self.scatters else 0.0

    def joined(self, other: AxisErrors | None) -> AxisErrors:
        """Return what two records of one axis say together: the larger lag, and the scatters of both."""
        if other is None:
            return self
        return replace(self, lag=max(self.lag, other.lag), scatters=(*self.scatters, *other.scatters))


@dataclass(frozen=True, eq=False)
class SwingLaw:
    """How one mode's restoring and damping forces change with its swing, and the air's hold on a moving hub.

    Parameters
    ----------
    mode, output : int -- whose swing y the law is stated for, from 0
    stiffening, stiffening_sd : float -- kappa of ``kappa y^3`` [1/(m^2 s^2)]
    drag, drag_sd : float -- beta of ``beta |y'| y'`` [1/m]
    shape, lengths : ndarray, shape (n_heights,)
        Deflection of the mode along the beam, 1 at the output, and the length that each height stands for [m].
    """

    mode: int
    output: int
    stiffening: float
    stiffening_sd: float
    drag: float
    drag_sd: float
    shape: FloatArray
    lengths: FloatArray

    def forces(
        self, velocities: FloatArray, y: FloatArray, rates: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what stiffening and drag do to the mode, each of shape (n,), in m/s^2 of y.

        Parameters
        ----------
        velocities : ndarray, shape (n,) -- of the hub [m/s]
        y, rates : ndarray, shape (n,) -- swing of the output and its rate [m], [m/s]

        Notes
        -----
        The drag of every piece of the beam goes with the square of its own speed, hub and swing together; with a
        hub at rest the sum over the beam is ``beta |y'| y'``.
        """
        speeds = velocities[:, None] + rates[:, None] * self.shape
        weights = self.lengths * self.shape
        still = float(self.lengths @ np.abs(self.shape) ** 3)
        return self.stiffening * y**3, self.drag * (np.abs(speeds) * speeds) @ weights / still


def swing_law(
    curves: AmplitudeCurves, model: ModalModel, shape: FloatArray, lengths: FloatArray
) -> tuple[SwingLaw, float, float]:
    """Return the law that curves over amplitude show, with frequency [rad/s] and damping of the smallest swings.

    Parameters
    ----------
    curves : AmplitudeCurves -- in metres
    model : ModalModel -- with an output of the curves' name, and a mode near their frequency
    shape, lengths : ndarray, shape (n_heights,) -- of the mode along the beam, in any scale; see ``SwingLaw``

    Notes
    -----
    To first order ``omega(A) = omega + 3 kappa A^2 / (8 omega)`` and ``zeta omega(A) = zeta omega + 4 beta omega A /
    (3 pi)``: straight lines over A^2 and A, fitted to the curves with their standard deviations.
    """
    if curves.output_name not in model.output_names or curves.unit != "m":
        raise EstimationError(
            f"curves over the amplitude of {curves.output_name} [{curves.unit}] beside a model of "
            f"{', '.join(model.output_names)}; expected curves of one of these in m: identify with --amplitude"
        )
    output = model.output_names.index(curves.output_name)
    omegas = 2.0 * np.pi * curves.frequencies_hz
    mode = int(np.argmin(np.abs(model.natural_frequencies - float(np.mean(omegas)))))
    frequency = _line(curves.amplitudes**2, omegas, 2.0 * np.pi * curves.frequency_sd_hz)
    rate = _line(curves.amplitudes, curves.damping_ratios * omegas, curves.damping_sd * omegas)
    omega = frequency.start
    law = SwingLaw(
        mode,
        output,
        8.0 / 3.0 * omega * frequency.slope,
        8.0 / 3.0 * omega * math.hypot(frequency.slope_sd, _LAW_SD * frequency.slope),
        0.75 * math.pi / omega * rate.slope,
        0.75 * math.pi / omega * math.hypot(rate.slope_sd, _LAW_SD * rate.slope),
        shape,
        lengths,
    )
    return law, omega, rate.start / omega


class _Line(NamedTuple):
    start: float
    slope: float
    slope_sd: float


def _line(x: FloatArray, y: FloatArray, sd: FloatArray) -> _Line:
    """Return the straight line through a curve, and what the curve's deviations at its ends make of the slope."""
    columns = np.stack([np.ones_like(x), x], axis=1) / sd[:, None]
    start, slope = np.linalg.lstsq(columns, y / sd, rcond=None)[0]
    return _Line(float(start), float(slope), float(math.hypot(sd[0], sd[-1]) / (x[-1] - x[0])))


@dataclass(frozen=True, eq=False)
class Draws:
    """Beams as they may be.

    Attributes
    ----------
    poles : ndarray of complex, shape (n_draws, n_modes) -- [rad/s]
    shares : ndarray, shape (n_draws, n_outputs, n_modes) -- residues
    lag_before : ndarray, shape (n_draws,) -- where the hub lags before the move, in lags, from -1 to 1
    scatter : ndarray of complex, shape (n_draws, n_modes) -- standard normal in both parts
    law : ndarray, shape (n_draws, 2) -- standard normal, of stiffening and drag
    """

    poles: ComplexArray
    shares: FloatArray
    lag_before: FloatArray
    scatter: ComplexArray
    law: FloatArray


@dataclass(frozen=True, eq=False)
class KnownBeam:
    """Everything that a prediction of a move's swing rests on.

    Parameters
    ----------
    model : ModalModel -- of a moved base, with one input
    drift : PoleDrift
    axis : AxisErrors
    law : SwingLaw, optional -- where curves over amplitude are known
    seed : int -- of the draws

    Raises
    ------
    EstimationError
        No modes, several inputs, or a force as input.
    """

    model: ModalModel
    drift: PoleDrift = field(default_factory=PoleDrift)
    axis: AxisErrors = field(default_factory=AxisErrors)
    law: SwingLaw | None = None
    seed: int = 1

    def __post_init__(self) -> None:
        model = self.model
        if model.further_inputs or not ModalStructure(model.structure).is_motion:
            raise EstimationError(
                f"the model is of structure {model.structure!r} with the inputs {', '.join(model.input_names)}; "
                "moves are shaped for one moved base: expected base_motion, velocity or acceleration. Identify with "
                "the hub's motion as input"
            )
        if not model.n_modes:
            raise EstimationError(
                "the model has no modes, and nothing rings: identify a record that shows some"
            )

    @property
    def is_nominal(self) -> bool:
        """Whether the model says nothing of its own uncertainty."""
        n = 2 * self.model.n_modes
        own = np.diag(self.model.covariance)[:n]
        return not (np.all(np.isfinite(self.model.covariance)) and np.all(own > 0.0))

    def with_spread(self, factor: float) -> KnownBeam:
        """Return the same beam, known better (or worse): all standard deviations of modes times a factor."""
        drift = PoleDrift(factor * self.drift.frequency_sd, factor * self.drift.damping_sd)
        covariance = self.model.covariance if self.is_nominal else factor**2 * self.model.covariance
        return replace(self, model=replace(self.model, covariance=covariance), drift=drift)

    @property
    def frequency_sd(self) -> FloatArray:
        """Relative standard deviations of the natural frequencies, drift included, shape (n_modes,)."""
        own = np.zeros(self.model.n_modes)
        if not self.is_nominal:
            own = self.model.natural_frequency_sd / self.model.natural_frequencies
        return np.hypot(own, self.drift.frequency_sd)

    @property
    def damping_sd(self) -> FloatArray:
        """Standard deviations of the damping ratios, drift included, shape (n_modes,)."""
        own = np.zeros(self.model.n_modes) if self.is_nominal else self.model.damping_ratio_sd
        return np.hypot(own, self.drift.damping_sd * np.abs(self.model.damping_ratios))

    @cached_property
    def draws(self) -> Draws:
        """``DRAWS`` beams, seeded: the same for every move, so that moves compare."""
        model, rng = self.model, np.random.default_rng(self.seed)
        n, m = model.n_modes, len(model.output_names)
        parameters = np.tile(model.parameters, (DRAWS, 1))
        normal = rng.standard_normal(parameters.shape)
        if not self.is_nominal:
            values, vectors = np.linalg.eigh(model.covariance)
            parameters = parameters + (normal * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
        omegas, zetas = parameters[:, :n], parameters[:, n : 2 * n]
        omegas = omegas * np.exp(self.drift.frequency_sd * rng.standard_normal((DRAWS, n)))
        zetas = zetas * np.exp(self.drift.damping_sd * rng.standard_normal((DRAWS, n)))
        zetas = np.clip(zetas, -_MOST_DAMPING, _MOST_DAMPING)
        own = parameters[:, 2 * n + 2 :].reshape(DRAWS, m, n + 2)
        before = rng.uniform(-1.0, 1.0, DRAWS)
        if self.axis.before is not None:
            before = np.full(DRAWS, -float(np.sign(self.axis.before)))
        scatter = rng.standard_normal((DRAWS, n)) + 1j * rng.standard_normal((DRAWS, n))
        poles = omegas * (-zetas + 1j * np.sqrt(1.0 - zetas**2))
        return Draws(poles, own[:, :, 2:], before, scatter, rng.standard_normal((DRAWS, 2)))
