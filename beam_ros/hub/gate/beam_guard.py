"""What the hub may do to the beam: one guard for sequences and set-points, on any axis link."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beam_model import BeamModel, HeldLoads, LoadTrace, PredictedLoads
from beam_ros.arrays import FloatArray
from beam_ros.hub.parameters import AxisParameters


@dataclass(frozen=True)
class BeamLimits:
    """How far the beam may be loaded.

    Parameters
    ----------
    max_tip_deflection : float
        [m]
    max_root_strain : float
        At the strip's surface at the clamp.
    max_hub_force : float
        That moves the hub, with the beam's reaction [N].
    """

    max_tip_deflection: float
    max_root_strain: float
    max_hub_force: float

    def objection(self, loads: PredictedLoads, lowered: str) -> str | None:
        """Return which limit these loads leave and by how much ``lowered`` has to be lowered, or None."""
        limit = self.max_tip_deflection
        if loads.tip_deflection > limit:
            return (
                f"predicted tip deflection {loads.tip_deflection * 1e3:.3g} mm: the limit "
                f"hub.max_tip_deflection is {limit * 1e3:g} mm; lower {lowered} to "
                f"{100 * limit / loads.tip_deflection:.0f} %"
            )
        limit = self.max_root_strain
        if loads.root_strain > limit:
            return (
                f"predicted root strain {loads.root_strain:.3g}: the limit beam.max_root_strain is "
                f"{limit:g}; lower {lowered} to {100 * limit / loads.root_strain:.0f} %"
            )
        limit = self.max_hub_force
        if loads.hub_force > limit:
            return (
                f"predicted hub force {loads.hub_force:.3g} N: the limit hub.max_effort is "
                f"{limit:g} N; lower {lowered}"
            )
        return None if math.isfinite(loads.tip_deflection) else "prediction diverged"


class BeamGuard:
    """The beam's model and limits, as the command gate needs them.

    Parameters
    ----------
    model : BeamModel
        Beam and hub.
    thickness : float
        Of the strip in the direction of motion [m].
    limits : BeamLimits
        How far the beam may be loaded.
    parameters : AxisParameters
        Command mode, period and limits of the axis that moves it.

    Attributes
    ----------
    led : HeldLoads
        The beam on a hub whose acceleration is prescribed.
    ring_ticks : int
        A period of the slowest mode: what rings freely shows its peak within it.
    """

    def __init__(
        self, model: BeamModel, thickness: float, limits: BeamLimits, parameters: AxisParameters
    ) -> None:
        self.limits = limits
        self._model = model
        self._thickness = thickness
        self._parameters = parameters
        self.led = HeldLoads(model, parameters.period, thickness)
        self.ring_ticks = math.ceil(2 * math.pi / float(model.natural_frequencies[0]) / parameters.period)
        self._has_air = model.matrices.resists_hub
        self._n_modes = model.n_modes
        self._pushed: HeldLoads | None = None
        if parameters.command_mode == "effort":
            self._pushed = HeldLoads(model, parameters.period, thickness, is_free=True)

    def sequence(self, position: float = 0.0, beam: FloatArray | None = None) -> SequenceLoads:
        """Begin to predict a sequence for a hub at rest at ``position`` [m]; ``beam`` is the state of ``led``."""
        is_free = self._pushed is not None
        trace = LoadTrace(
            self._model,
            self._parameters.period,
            self._thickness,
            is_free=is_free,
            state=None if beam is None else beam[self.led.elastic],
            position=position,
        )
        return SequenceLoads(trace, self.limits, self._parameters)

    def with_velocity(self, beam: FloatArray, velocity: float) -> FloatArray:
        """Return the state of a beam whose hub moves with ``velocity`` [m/s], which matters in air alone."""
        if not self._has_air:
            return beam
        result = np.array(beam)
        result[2 * self._n_modes] = velocity
        return result

    def pushed_after(
        self, position: float, velocity: float, beam: FloatArray, force: float, n_ticks: int
    ) -> tuple[float, float, FloatArray]:
        """Return position [m], velocity [m/s] and beam of a free hub after some ticks under a force [N]."""
        assert self._pushed is not None
        state = self._pushed.after(self._free_state(position, velocity, beam), force, n_ticks)
        elastic = np.zeros_like(beam)
        elastic[self.led.elastic] = state[self._pushed.elastic]
        velocity = float(state[self._n_modes + 1])
        return float(state[0]), velocity, self.with_velocity(elastic, velocity)

    def pushed_peaks(
        self, position: float, velocity: float, beam: FloatArray, force: float, n_ticks: int
    ) -> FloatArray:
        """Return the loads of a beam on a free hub in these ticks under a force [N]; see ``HeldLoads.peaks``."""
        assert self._pushed is not None
        state = self._free_state(position, velocity, beam)
        return self._pushed.peaks(state, force, n_ticks)

    def _free_state(self, position: float, velocity: float, beam: FloatArray) -> FloatArray:
        assert self._pushed is not None
        state = np.zeros(self._pushed.n_states)
        state[0], state[self._n_modes + 1] = position, velocity
        state[self._pushed.elastic] = beam[self.led.elastic]
        return state


class SequenceLoads:
    """What a sequence would do to the beam, and to a hub that is pushed.

    Parameters
    ----------
    trace : LoadTrace
        At the sequence's beginning.
    limits : BeamLimits
    parameters : AxisParameters
        Command mode, period and limits.
    """

    def __init__(self, trace: LoadTrace, limits: BeamLimits, parameters: AxisParameters) -> None:
        self._trace = trace
        self._limits = limits
        self._parameters = parameters
        self._before: FloatArray | None = None

    def add(self, values: FloatArray) -> str | None:
        """Go on with the samples of the next ticks, shape (n_ticks,); return why the hub must not run them."""
        parameters, trace = self._parameters, self._trace
        order = {"acceleration": 0, "velocity": 1, "position": 2, "effort": 0}[parameters.command_mode]
        drive = values
        if order:
            if self._before is None:
                self._before = np.zeros(1) if order == 1 else np.full(2, values[0])
            known = np.concatenate((self._before, values))
            self._before = known[-order:]
            drive = np.diff(known, order) / parameters.period**order
        trace.add(drive)
        if trace.position > parameters.position_limit and parameters.command_mode == "effort":
            return (
                f"predicted to take the free hub to {trace.position:.3g} m from home: the travel ends at "
                f"+-{parameters.position_limit:g} m; make it smaller"
            )
        if trace.velocity > parameters.max_speed:
            return (
                f"predicted to give the free hub {trace.velocity:.3g} m/s: the limit is "
                f"{parameters.max_speed:g} m/s; make it smaller"
            )
        return None

    def objection(self) -> str | None:
        """Return which limit of the beam's the samples so far leave, or None."""
        return self._limits.objection(self._trace.loads, "excitation.acceleration")

    @property
    def loads(self) -> PredictedLoads:
        """The largest loads so far."""
        return self._trace.loads
