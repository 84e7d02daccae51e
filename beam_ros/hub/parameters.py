"""The hub's parameters: what the axis can do, how it is reached, and what a simulated device has.

All values are SI. Each class is frozen and checks itself, so that whatever holds one may trust it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

from beam_ros.hub.errors import HubParameterError

CommandMode = Literal["acceleration", "velocity", "position", "effort"]
COMMAND_MODES: tuple[CommandMode, ...] = get_args(CommandMode)

Hold = Literal["zoh", "linear"]

BATCH_NS = 20_000_000
MAX_WATCHDOG_S = 4.0
"""The longest silence [s]: an axis that runs on for longer is not guarded, and 32 bits of nanoseconds hold it."""
MAX_BATCH_TICKS = 100
"""Most ticks in one batch, which one telemetry frame of the line protocol carries."""


@dataclass(frozen=True)
class AxisParameters:
    """The axis and its controller: limits, command mode, tick and watchdog.

    Parameters
    ----------
    travel : float
        Whole travel [m]; home is in its middle, so positions stay within +-travel/2.
    max_speed : float
        Greatest speed [m/s].
    max_acceleration : float
        Greatest acceleration [m/s^2].
    stop_deceleration : float
        Every stop decelerates at it [m/s^2].
    max_effort : float
        Greatest force [N].
    encoder_resolution : float
        One count of the position encoder [m].
    command_mode : {"acceleration", "velocity", "position", "effort"}
        What set-points and sequences mean.
    period_ns : int
        The device's tick [ns of device time].
    max_following_error : float
        Greatest distance of the hub from where its commands lead it [m], that of the servo's lag; beyond it
        the host stops the axis.
    watchdog_s : float
        Silence of the host after which an enabled axis stops by itself [s of device time]; also the
        age at which an acceleration, velocity or effort set-point must have been refreshed.
    move_speed, move_acceleration : float
        Limits of the profiled move to a position set-point [m/s], [m/s^2].
    homing_speed, homing_acceleration : float
        Limits of the move that looks for home [m/s], [m/s^2].
    """

    travel: float = 0.1
    max_speed: float = 0.5
    max_acceleration: float = 10.0
    stop_deceleration: float = 10.0
    max_effort: float = 20.0
    encoder_resolution: float = 1e-7
    command_mode: CommandMode = "acceleration"
    period_ns: int = 1_000_000
    max_following_error: float = 0.002
    watchdog_s: float = 0.25
    move_speed: float = 0.05
    move_acceleration: float = 0.5
    homing_speed: float = 0.02
    homing_acceleration: float = 0.2

    def __post_init__(self) -> None:
        whole = {"period_ns"}
        for name in self.__dataclass_fields__.keys() - {"command_mode"}:
            _check_positive(name, getattr(self, name), is_whole=name in whole)
        if self.command_mode not in COMMAND_MODES:
            raise _refusal("command_mode", self.command_mode, "one of " + ", ".join(COMMAND_MODES))
        if self.watchdog_s > MAX_WATCHDOG_S:
            raise _refusal("watchdog_s", self.watchdog_s, f"at most {MAX_WATCHDOG_S} s")
        if self.watchdog_s * 1e9 < 2 * self.batch_ns:
            raise _refusal("watchdog_s", self.watchdog_s, f"at least two batches ({2e-9 * self.batch_ns} s)")
        for kind in ("move", "homing"):
            for quantity in ("speed", "acceleration"):
                name, limit = f"{kind}_{quantity}", f"max_{quantity}"
                if getattr(self, name) > getattr(self, limit):
                    raise _refusal(name, getattr(self, name), f"at most {limit} = {getattr(self, limit)}")

    @cached_property
    def period(self) -> float:
        """The device's tick [s of device time]."""
        return self.period_ns * 1e-9

    @property
    def batch_ticks(self) -> int:
        """Ticks in one batch of samples: about 20 ms, at least one tick and at most what a frame holds."""
        return min(max(round(BATCH_NS / self.period_ns), 1), MAX_BATCH_TICKS)

    @property
    def batch_ns(self) -> int:
        """Length of one batch of samples [ns of device time]."""
        return self.batch_ticks * self.period_ns

    @cached_property
    def watchdog_ticks(self) -> int:
        """The watchdog's patience in ticks."""
        return round(self.watchdog_s * 1e9 / self.period_ns)

    @cached_property
    def position_limit(self) -> float:
        """Greatest distance from home [m]."""
        return self.travel / 2

    @property
    def command_limit(self) -> float:
        """Greatest magnitude of a set-point or sample, in the command mode's unit."""
        return {
            "acceleration": self.max_acceleration,
            "velocity": self.max_speed,
            "position": self.position_limit,
            "effort": self.max_effort,
        }[self.command_mode]

    @property
    def command_unit(self) -> str:
        """Unit of set-points and samples."""
        return {"acceleration": "m/s^2", "velocity": "m/s", "position": "m", "effort": "N"}[self.command_mode]

    @cached_property
    def is_ramped(self) -> bool:
        """Whether the velocity runs linearly through a tick; else it jumps at its beginning and stays."""
        return self.command_mode in ("acceleration", "effort")

    @property
    def hold(self) -> Hold:
        """How the applied values continue between two ticks."""
        return "linear" if self.command_mode == "position" else "zoh"

    def widened(self, factor: float) -> AxisParameters:
        """Return the axis with its travel, limits and watchdog larger by a factor."""
        limits = (
            *("travel", "max_speed", "max_acceleration", "stop_deceleration", "max_effort"),
            *("move_speed", "move_acceleration", "homing_speed", "homing_acceleration"),
        )
        wider = {name: getattr(self, name) * factor for name in limits}
        return replace(self, watchdog_s=min(self.watchdog_s * factor, MAX_WATCHDOG_S), **wider)

    def check_within_travel(self, name: str, position: float) -> None:
        """Raise ``HubParameterError`` where a position [m], which the parameter ``name`` gives, is off the axis."""
        if not abs(position) <= self.position_limit:
            raise _refusal(name, position, f"within +-{self.position_limit} m")


@dataclass(frozen=True)
class LinkParameters:
    """How the real controller is reached.

    Parameters
    ----------
    serial_port : str
        Its port, such as ``/dev/ttyACM0`` or ``socket://host:4000``.
    serial_baud : int
        Bits per second on that port.
    patience_s : float
        A port that is not there at the start is no fault before this time [s].
    max_clock_sd_ns : int
        Standard deviation of the clock map above which no sequence starts [ns].
    prove_watchdog : bool
        Whether every connection begins with a silence that the device must notice.
    """

    serial_port: str = ""
    serial_baud: int = 921_600
    patience_s: float = 0.0
    max_clock_sd_ns: int = 50_000
    prove_watchdog: bool = True

    def __post_init__(self) -> None:
        for name in ("serial_baud", "max_clock_sd_ns"):
            _check_positive(name, getattr(self, name), is_whole=True)

    @property
    def shortcomings(self) -> tuple[str, ...]:
        """What is not known of the device behind the port, for people."""
        if self.prove_watchdog:
            return ()
        return ("the controller's watchdog is believed, not proved: axis.prove_watchdog is off",)


@dataclass(frozen=True)
class SimulatedDevice:
    """What only a simulated or emulated device has: its start, its buffer, its clock and its encoder.

    Parameters
    ----------
    initial_position : float
        Where the hub stands at power-on, seen from its home [m].
    buffer_samples : int
        Samples of a sequence that the emulated firmware can hold; the simulated hub holds any number.
    clock_drift_ppm : float
        By how much the device's clock runs fast [1e-6].
    clock_start_ns : int
        What the device's clock reads at power-on [ns].
    encoder_noise : float
        Standard deviation of the measured position, white from tick to tick [m]; speeds come from the drive's
        observer, which is quiet.
    encoder_at : {"hub", "drive"}
        What the encoder measures: the hub, or the drive, before its play and compliance.
    seed : int
        Of the encoder's noise.
    """

    initial_position: float = 0.0
    buffer_samples: int = 512
    clock_drift_ppm: float = 0.0
    clock_start_ns: int = 0
    encoder_noise: float = 0.0
    encoder_at: Literal["hub", "drive"] = "hub"
    seed: int = 0

    def __post_init__(self) -> None:
        if not abs(self.clock_drift_ppm) <= 1000.0:
            raise _refusal("clock_drift_ppm", self.clock_drift_ppm, "between -1000 and 1000")
        if not 0.0 <= self.encoder_noise < math.inf:
            raise _refusal("encoder_noise", self.encoder_noise, "a finite number, at least 0")
        for name, least in (("clock_start_ns", 0), ("buffer_samples", 64)):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool) or value < least:
                raise _refusal(name, value, f"a whole number, at least {least}")


def _check_positive(name: str, value: object, *, is_whole: bool) -> None:
    if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
        raise _refusal(name, value, "a finite number greater than 0")
    if is_whole and (not isinstance(value, int) or isinstance(value, bool)):
        raise _refusal(name, value, "a whole number")


def _refusal(name: str, value: object, expected: str) -> HubParameterError:
    return HubParameterError(
        f"hub parameter {name} = {value!r}: expected {expected}; correct it in the rig file"
    )
