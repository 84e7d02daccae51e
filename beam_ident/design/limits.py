"""How near an excitation comes to its limits: those of the axis, and of whatever else follows the drive.

Everything here is linear in the excitation. The quantities of an axis (travel, speed, acceleration, jerk) are sums of
its held accelerations; others (a tip, a strain, the force on a hub) follow through known modes, whose recursion from
tick to tick is exact for held values:

    x[k+1] = e^(pT) x[k] + (e^(pT) - 1) / p  u[k],      q = Im x / omega_d,   q' = Im(p x) / omega_d
"""

from __future__ import annotations

import math
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.errors import ExcitationError
from beam_ident.excitation.recipe import Recipe
from beam_ident.excitation.sampled import AxisLimits
from beam_ident.modal.model import ModalModel
from beam_ident.modal.structure import ModalStructure
from beam_ident.numerics.pole_response import recursion

_RATES = ("mobility", "accelerance")


@dataclass(frozen=True, eq=False)
class LimitedResponse:
    """Quantities that follow the drive through known modes, and how large they may become.

    Parameters
    ----------
    model : ModalModel
        Its outputs are the quantities, its input is the drive: of a moved base any structure of motion, of a force
        force, receptance, mobility or accelerance. An accelerance, whose outputs are second derivatives, goes with
        the acceleration of a moved base as well. Residual terms of mobility and accelerance are refused: they would
        differentiate a held drive.
    limits : mapping of str to float -- largest absolute value of some outputs, by name

    Raises
    ------
    ExcitationError
        A limit that is not positive, or of no output of the model.
    """

    model: ModalModel
    limits: Mapping[str, float]

    def __post_init__(self) -> None:
        for name, limit in self.limits.items():
            if name not in self.model.output_names:
                raise ExcitationError(
                    f"limits: {name!r} is not an output of the model; expected some of "
                    f"{', '.join(self.model.output_names)}"
                )
            if not limit > 0.0:
                raise ExcitationError(f"limits: {name} is {limit!r}; expected a number > 0")
        if self.model.structure in _RATES and np.any(self.model.residual_terms):
            raise ExcitationError(
                f"limits: a {self.model.structure} with residual terms differentiates a held drive; expected 0. "
                "Leave them out, or limit a displacement"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the limited quantities."""
        return tuple(name for name, limit in self.limits.items() if math.isfinite(limit))

    @cached_property
    def _rows(self) -> FloatArray:
        return np.array([self.model.output_names.index(name) for name in self.names], dtype=np.intp)

    @cached_property
    def _sizes(self) -> FloatArray:
        return np.array([self.limits[name] for name in self.names], dtype=np.float64)

    def with_poles(self, known: ModalModel, moved: ModalModel) -> LimitedResponse:
        """Return the same quantities where modes lie as in ``moved`` instead of in ``known``.

        Each own mode goes where the mode of ``known`` goes that is nearest to it, within a quarter of its frequency.
        """
        own, at = self.model, known.natural_frequencies
        omegas, zetas = own.natural_frequencies.copy(), own.damping_ratios.copy()
        for k, omega in enumerate(own.natural_frequencies):
            nearest = int(np.argmin(np.abs(at - omega)))
            if abs(at[nearest] - omega) < 0.25 * omega:
                omegas[k] = moved.natural_frequencies[nearest]
                zetas[k] = moved.damping_ratios[nearest]
        # A deflection that a static load makes stays as it was: of a softer beam it is larger.
        return replace(self, model=replace(own, natural_frequencies=omegas, damping_ratios=zetas))

    def responses(
        self,
        drive: FloatArray,
        positions: FloatArray,
        period_s: float,
        states: MutableMapping[complex, ComplexArray],
    ) -> FloatArray:
        """Return the quantities over their limits at every tick, shape (n_quantities, n_ticks).

        Parameters
        ----------
        drive : ndarray, shape (n_ticks,) -- held: accelerations of a moved base [m/s^2], or forces [N]
        positions : ndarray, shape (n_ticks,) -- twice the integral of the drive at the ticks
        period_s : float -- [s]
        states : mutable mapping of complex to ndarray, shape (n_ticks,)
            The recursions by their poles under this drive; those that are not there yet are added. Tip, strain and
            force share the modes of one structure.
        """
        model, structure = self.model, ModalStructure(self.model.structure)
        residues, rows = model.residues[self._rows], self._rows
        is_rate, is_second = structure.kind == "mobility", structure.kind == "accelerance"
        sign = -1.0 if structure.is_motion else 1.0
        found = np.zeros((len(rows), len(drive)))
        for k, (omega, zeta) in enumerate(zip(model.natural_frequencies, model.damping_ratios, strict=True)):
            pole = omega * complex(-zeta, math.sqrt(1.0 - zeta**2))
            if pole not in states:
                step = np.exp(pole * period_s)
                states[pole] = recursion(np.array([step]), (step - 1.0) / pole * drive, 0.0)[:-1]
            x = states[pole]
            if is_second:
                mode = drive + (pole**2 * x).imag / pole.imag
            else:
                mode = ((pole if is_rate else 1.0) * x).imag / pole.imag
            found += sign * np.outer(residues[:, k], mode)
        if not (is_rate or is_second):
            found += sign * np.outer(model.residual_terms[rows], drive)
        if structure.has_direct:
            direct = drive if is_second else np.gradient(positions, period_s) if is_rate else positions
            found += np.outer(model.gains[rows], direct)
        return found / self._sizes[:, None]

    def frequency_response(self, omegas: FloatArray) -> ComplexArray:
        """Return the response from the drive to the quantities over their limits, shape (n_omegas, n_quantities)."""
        return response_to_drive(self.model, omegas)[:, self._rows] / self._sizes


def response_to_drive(model: ModalModel, omegas: FloatArray) -> ComplexArray:
    """Return the outputs per acceleration of a moved base, or per force, shape (n_omegas, n_outputs)."""
    structure = ModalStructure(model.structure)
    s = 1j * omegas
    front = structure.sign * np.ones_like(s) if structure.is_motion else s**structure.differentiations
    omega, zeta = model.natural_frequencies, model.damping_ratios
    modes = 1.0 / (s[:, None] ** 2 + 2.0 * zeta * omega * s[:, None] + omega**2)
    found = front[:, None] * (modes @ model.residues.T + model.residual_terms)
    if structure.has_direct:
        power = -2 if structure.is_motion else structure.differentiations - 2
        found = found + (s**power)[:, None] * model.gains
    return np.asarray(found, dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class ExcitationLimits:
    """Everything that an excitation must keep.

    Parameters
    ----------
    axis : AxisLimits -- of the motion that the recipe describes
    responses : sequence of LimitedResponse
    scale : float
        What one m/s^2 of the recipe becomes as drive: 1 for a moved base, the mass moved [kg] for a force.
    period_s : float -- of the hold [s]
    """

    axis: AxisLimits
    responses: Sequence[LimitedResponse] = ()
    scale: float = 1.0
    period_s: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("scale", "period_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ExcitationError(f"limits: {name} is {value!r}; expected a finite number > 0")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all limited quantities: those of the axis, then the responses'."""
        return (*self._of_axis, *(name for own in self.responses for name in own.names))

    @property
    def _of_axis(self) -> dict[str, float]:
        """Return the finite limits of the axis."""
        every = {name: getattr(self.axis, name) for name in ("travel", "speed", "acceleration", "jerk")}
        return {name: value for name, value in every.items() if math.isfinite(value)}

    def with_poles(self, known: ModalModel, moved: ModalModel) -> ExcitationLimits:
        """Return the same limits where modes lie as in ``moved`` instead of in ``known``."""
        return replace(self, responses=tuple(own.with_poles(known, moved) for own in self.responses))

    def over_time(self, accelerations: FloatArray) -> FloatArray:
        """Return all quantities over their limits at every tick, shape (n_quantities, n_ticks).

        Parameters
        ----------
        accelerations : ndarray, shape (n_ticks,) -- that a recipe holds [m/s^2]
        """
        period = self.period_s
        velocities = np.concatenate([[0.0], np.cumsum(accelerations)]) * period
        positions = np.concatenate([[0.0], np.cumsum(0.5 * (velocities[:-1] + velocities[1:])) * period])
        motion = {
            "travel": positions[1:],
            "speed": velocities[1:],
            "acceleration": accelerations,
            "jerk": np.diff(accelerations, prepend=0.0) / period,
        }
        rows = [motion[name][None] / limit for name, limit in self._of_axis.items()]
        drive, states = self.scale * accelerations, dict[complex, ComplexArray]()
        rows += [own.responses(drive, self.scale * positions[:-1], period, states) for own in self.responses]
        return np.concatenate(rows) if rows else np.zeros((0, len(accelerations)))

    def shares(self, recipe: Recipe) -> dict[str, float]:
        """Return the peak of every quantity over its limit, by name."""
        peaks = np.max(np.abs(self.over_time(recipe.sample(self.period_s).accelerations)), axis=1)
        return dict(zip(self.names, peaks.tolist(), strict=True))

    def gains(self, omegas: FloatArray) -> FloatArray:
        """Return the squared magnitude of all quantities over their limits per m/s^2, (n_omegas, n_quantities)."""
        motion = {
            "travel": omegas**-2.0,
            "speed": omegas**-1.0,
            "acceleration": np.ones_like(omegas),
            "jerk": omegas,
        }
        columns = [motion[name][:, None] / limit for name, limit in self._of_axis.items()]
        columns += [self.scale * np.abs(own.frequency_response(omegas)) for own in self.responses]
        return np.square(np.concatenate(columns, axis=1)) if columns else np.zeros((len(omegas), 0))
