"""A complete sequence against the axis's limits and the beam's, block by block, in a thread of its own.

Half an hour at 1 kHz takes some seconds. Neither the executor nor the lock of a line can be kept waiting for
that: both are the heartbeat for which the device's watchdog listens.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from beam_ident.numerics.blas_threads import one_blas_thread
from beam_ros.arrays import FloatArray
from beam_ros.hub.gate.beam_guard import SequenceLoads
from beam_ros.hub.gate.sequence_assembly import Sequence, SequenceAssembler
from beam_ros.hub.parameters import AxisParameters

POSITION_TOLERANCE = 2e-6
"""How far the first position may lie from where the hub is [m]; also the slack on the travel."""
REST_SPEED = 1e-5
"""A slower hub counts as being at rest [m/s]."""
RELATIVE_TOLERANCE = 1e-6
"""Slack on speed and acceleration, for what rounding does to a design that uses its limits fully."""


class SequenceMotion:
    """The hub's motion under a sequence, integrated from rest and held against the axis's limits.

    Parameters
    ----------
    parameters : AxisParameters
        The axis's limits.
    position : float
        Where the hub rests now [m].

    Notes
    -----
    With the period T and samples c_k, the motion is integrated as the device does it: acceleration mode
    x_{k+1} = x_k + v_k T + c_k T^2/2, v_{k+1} = v_k + c_k T; velocity mode x_{k+1} = x_k + c_k T; position
    mode moves from c_k to c_{k+1} during tick k. Effort mode cannot be predicted without the beam: there
    only the samples' size is checked here, and ``SequenceLoads`` does the rest.
    """

    def __init__(self, parameters: AxisParameters, position: float) -> None:
        self._parameters = parameters
        self._position = position
        self._velocity = 0.0
        self._n_ticks = 0

    def add(self, values: FloatArray) -> str | None:
        """Go on with the samples of the next ticks, shape (n_ticks,); return why the axis must not run them."""
        first, self._n_ticks = self._n_ticks, self._n_ticks + len(values)
        if not np.all(np.isfinite(values)):
            k = int(np.flatnonzero(~np.isfinite(values))[0])
            return f"sample {first + k} is {values[k]}: expected finite numbers"
        parameters, mode = self._parameters, self._parameters.command_mode
        if mode == "effort":
            return _exceeded("effort", values, parameters.max_effort, parameters.command_unit, first)
        if first == 0:
            objection = self._start(float(values[0]))
            if objection:
                return objection
        if mode == "acceleration":
            accelerations, velocities, positions = self._ramped(values)
        else:
            accelerations, velocities, positions = self._stepped(values, is_first=first == 0)
        self._velocity, self._position = float(velocities[-1]), float(positions[len(velocities) - 1])
        for name, array, limit, unit in (
            ("acceleration", accelerations, parameters.max_acceleration, "m/s^2"),
            ("speed", velocities, parameters.max_speed, "m/s"),
        ):
            objection = _exceeded(name, array, limit, unit, first)
            if objection:
                return objection
        extreme = float(positions[int(np.argmax(np.abs(positions)))])
        if abs(extreme) > parameters.position_limit + POSITION_TOLERANCE:
            return (
                f"would take the hub to {extreme:.6f} m: the travel ends at +-{parameters.position_limit:g} m; "
                "make it smaller or start elsewhere"
            )
        return None

    def end(self) -> str | None:
        """Return why the axis must not run a sequence that ends here, or None."""
        if self._n_ticks < 2:
            return f"{self._n_ticks} samples: expected at least 2"
        parameters = self._parameters
        tick_speed = parameters.max_acceleration * parameters.period
        rest_speed = tick_speed if parameters.command_mode == "position" else REST_SPEED
        if abs(self._velocity) > rest_speed * (1 + RELATIVE_TOLERANCE):
            return f"ends with {self._velocity:.3g} m/s: expected to end at rest (below {rest_speed:g} m/s)"
        return None

    def _start(self, value: float) -> str | None:
        parameters, position = self._parameters, self._position
        if parameters.command_mode == "position" and abs(value - position) > POSITION_TOLERANCE:
            return (
                f"starts at {value:.6f} m, but the hub is at {position:.6f} m: expected the first "
                f"sample within {POSITION_TOLERANCE * 1e6:g} um; move there first"
            )
        first_speed = parameters.max_acceleration * parameters.period * (1 + RELATIVE_TOLERANCE)
        if parameters.command_mode == "velocity" and abs(value) > first_speed:
            return f"starts with {value:.6g} m/s, but the hub is at rest: expected a start from rest"
        return None

    def _ramped(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        period = self._parameters.period
        velocities = np.concatenate(([self._velocity], self._velocity + np.cumsum(values) * period))
        ways = (velocities[:-1] + velocities[1:]) * (period / 2)
        positions = np.concatenate(([self._position], self._position + np.cumsum(ways)))
        # The device guards every instant; between two ticks v may pass through zero and x turn round.
        turning = velocities[:-1] * velocities[1:] < 0.0
        turns = positions[:-1][turning] - velocities[:-1][turning] ** 2 / (2 * values[turning])
        return values, velocities, np.concatenate((positions, turns))

    def _stepped(self, values: FloatArray, *, is_first: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
        period = self._parameters.period
        if self._parameters.command_mode == "velocity":
            velocities = np.concatenate(([self._velocity], values))
            positions = self._position + np.concatenate(([0.0], np.cumsum(values) * period))
        else:
            # The first sample says where the hub is: nothing moves until the second.
            ends = values[1:] if is_first else values
            positions = np.concatenate(([self._position], ends))
            velocities = np.concatenate(([self._velocity], np.diff(positions) / period))
        return np.diff(velocities) / period, velocities, positions


def _exceeded(name: str, array: FloatArray, limit: float, unit: str, first: int) -> str | None:
    if len(array) == 0:
        return None
    k = int(np.argmax(np.abs(array)))
    if abs(array[k]) <= limit * (1 + RELATIVE_TOLERANCE):
        return None
    return f"{name} reaches {array[k]:.6g} {unit} at sample {first + k}: the limit is {limit:g} {unit}"


class SequenceCheck:
    """The check of one sequence, at once or in a thread.

    Parameters
    ----------
    assembler : SequenceAssembler
        Holds all chunks.
    parameters : AxisParameters
        The axis's limits.
    position : float
        Where the hub rests [m].
    loads : callable, optional
        Begins to predict what the beam would do; None where nobody knows the beam.

    Attributes
    ----------
    position : float
    sequence : Sequence or None
        The whole; None until it is put together.
    objection : str or None
        Why the axis must not run it; None while it is not known, or when there is nothing against it.
    """

    def __init__(
        self,
        assembler: SequenceAssembler,
        parameters: AxisParameters,
        position: float,
        loads: Callable[[], SequenceLoads] | None = None,
    ) -> None:
        self.position = position
        self.sequence: Sequence | None = None
        self.objection: str | None = None
        self._assembler = assembler
        self._motion = SequenceMotion(parameters, position)
        self._loads = loads
        self._is_cancelled = False
        self._done = threading.Event()

    @property
    def is_done(self) -> bool:
        """Whether ``objection`` is the last word."""
        return self._done.is_set()

    def begin(self, *, in_background: bool) -> None:
        """Do the check now, or begin it in a thread."""
        if in_background:
            threading.Thread(target=self._run, name="sequence-check", daemon=True).start()
        else:
            self._run()

    def cancel(self) -> None:
        """Let a check in a thread end at its next block."""
        self._is_cancelled = True

    def _run(self) -> None:
        try:
            # Threads of the linear algebra would wait for each other on the processors that the heartbeat needs.
            with one_blas_thread():
                self.objection = self._objection()
        except Exception as err:
            # A thread that died without a word would leave the sequence loading for ever.
            self.objection = (
                f"its check failed with {type(err).__name__}: {err}; report this with the sequence"
            )
            raise
        finally:
            self._done.set()

    def _objection(self) -> str | None:
        sequence = self._assembler.assemble()
        if isinstance(sequence, str):
            return sequence
        self.sequence = sequence
        loads = None if self._loads is None else self._loads()
        with np.errstate(over="ignore", invalid="ignore"):
            for block in sequence.blocks():
                if self._is_cancelled:
                    return "given up"
                objection = self._motion.add(block)
                if objection is None and loads is not None:
                    objection = loads.add(block)
                if objection:
                    return objection
        return self._motion.end() or (None if loads is None else loads.objection())
