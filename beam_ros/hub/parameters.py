"""The hub's parameters: what the axis can do, how it is commanded and how it is reached.

All values are SI. The class is frozen and checks itself, so that whatever holds a
``HubParameters`` may trust it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from beam_ros.hub.errors import HubParameterError

CommandMode = Literal["acceleration", "velocity", "position", "effort"]
COMMAND_MODES: tuple[str, ...] = get_args(CommandMode)

Hold = Literal["zoh", "linear"]


@dataclass(frozen=True)
class HubParameters:
    """The moving hub with its controller.

    Parameters
    ----------
    travel : float
        Whole travel [m]; home is in its middle, so positions stay within +-travel/2.
    max_speed : float
        Greatest speed [m/s].
    max_acceleration : float
        Greatest acceleration [m/s^2]; every stop decelerates at it.
    max_effort : float
        Greatest force [N].
    encoder_resolution : float
        One count of the position encoder [m].
    command_mode : {"acceleration", "velocity", "position", "effort"}
        What set-points and sequences mean.
    period_ns : int
        The device's tick [ns of device time].
    watchdog_s : float
        Silence of the host after which an enabled axis stops by itself [s of device time]; also the
        age at which an acceleration, velocity or effort set-point must have been refreshed.
    move_speed, move_acceleration : float
        Limits of the profiled move to a position set-point [m/s], [m/s^2].
    homing_speed, homing_acceleration : float
        Limits of the move that looks for home [m/s], [m/s^2].
    initial_position : float
        Where a simulated hub stands at power-on, seen from its home [m].
    buffer_samples : int
        Samples of a sequence that the emulated device can hold.
    serial_port : str
        Port of the real controller, such as ``/dev/ttyACM0``; empty for the simulator.
    serial_baud : int
        Bits per second on that port.
    max_clock_sd_ns : int
        Standard deviation of the clock map above which no sequence starts [ns].
    clock_drift_ppm : float
        By how much the simulated device's clock runs fast [1e-6].
    clock_start_ns : int
        What the simulated device's clock reads at power-on [ns].
    """

    travel: float = 0.1
    max_speed: float = 0.5
    max_acceleration: float = 10.0
    max_effort: float = 20.0
    encoder_resolution: float = 1e-7
    command_mode: CommandMode = "acceleration"
    period_ns: int = 1_000_000
    watchdog_s: float = 0.25
    move_speed: float = 0.05
    move_acceleration: float = 0.5
    homing_speed: float = 0.02
    homing_acceleration: float = 0.2
    initial_position: float = 0.0
    buffer_samples: int = 512
    serial_port: str = ""
    serial_baud: int = 921_600
    max_clock_sd_ns: int = 50_000
    clock_drift_ppm: float = 0.0
    clock_start_ns: int = 0

    def __post_init__(self) -> None:
        positive = (
            "travel",
            "max_speed",
            "max_acceleration",
            "max_effort",
            "encoder_resolution",
            "period_ns",
            "watchdog_s",
            "move_speed",
            "move_acceleration",
            "homing_speed",
            "homing_acceleration",
            "serial_baud",
            "max_clock_sd_ns",
        )
        for name in positive:
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
                raise _refusal(name, value, "a finite number greater than 0")
        for name in (
            "period_ns",
            "buffer_samples",
            "serial_baud",
            "max_clock_sd_ns",
            "clock_start_ns",
        ):
            value = getattr(self, name)
            if not isinstance(value, int) or isinstance(value, bool):
                raise _refusal(name, value, "a whole number")
        if self.command_mode not in COMMAND_MODES:
            raise _refusal("command_mode", self.command_mode, "one of " + ", ".join(COMMAND_MODES))
        if self.watchdog_s * 1e9 < 2 * self.batch_ns:
            raise _refusal("watchdog_s", self.watchdog_s, f"at least two batches ({2e-9 * self.batch_ns} s)")
        for name, limit in (
            ("move_speed", "max_speed"),
            ("homing_speed", "max_speed"),
            ("move_acceleration", "max_acceleration"),
            ("homing_acceleration", "max_acceleration"),
        ):
            if getattr(self, name) > getattr(self, limit):
                raise _refusal(name, getattr(self, name), f"at most {limit} = {getattr(self, limit)}")
        if not abs(self.initial_position) <= self.travel / 2:
            raise _refusal("initial_position", self.initial_position, f"within +-{self.travel / 2} m")
        if not abs(self.clock_drift_ppm) <= 1000.0:
            raise _refusal("clock_drift_ppm", self.clock_drift_ppm, "between -1000 and 1000")
        if self.clock_start_ns < 0:
            raise _refusal("clock_start_ns", self.clock_start_ns, "0 or more")
        if self.buffer_samples < 64:
            raise _refusal("buffer_samples", self.buffer_samples, "at least 64")

    @property
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

    @property
    def watchdog_ticks(self) -> int:
        """The watchdog's patience in ticks."""
        return round(self.watchdog_s * 1e9 / self.period_ns)

    @property
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

    @property
    def hold(self) -> Hold:
        """How the applied values continue between two ticks."""
        return "linear" if self.command_mode == "position" else "zoh"


BATCH_NS = 20_000_000
MAX_BATCH_TICKS = 100
"""Most ticks in one batch, which one telemetry frame of the line protocol carries."""


def _refusal(name: str, value: object, expected: str) -> HubParameterError:
    return HubParameterError(
        f"hub parameter {name} = {value!r}: expected {expected}; correct it in the rig file"
    )
