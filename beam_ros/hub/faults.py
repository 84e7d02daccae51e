"""Everything that can stop an axis, as one table: number, name, sentence and remedy.

The numbers are part of the line protocol: a device gives its own in ``Status``, the host's begin at 64.
docs/hub-faults.md prints the table, the firmware compiles it, ``hub/mode`` and the diagnostics carry its rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

FIRST_FREE_FAULT = 32
"""From here on to the host's, a firmware may have faults that this table does not know."""
FIRST_HOST_FAULT = 64
"""Numbers below are the device's own."""


@dataclass(frozen=True)
class Fault:
    """One row of the table.

    Parameters
    ----------
    number : int
        0 to 255; never given to something else.
    name : str
        For programs.
    sentence : str
        What has happened, for people.
    remedy : str
        What to do about its cause; which services lead back to an enabled axis, its state decides
        (``HubStatus.way_back``).
    needs_home : bool
        Whether the position is not to be believed before the axis has been homed again.
    """

    number: int
    name: str
    sentence: str
    remedy: str
    needs_home: bool = False

    @property
    def is_of_host(self) -> bool:
        """Whether the host noticed it; else the device did."""
        return self.number >= FIRST_HOST_FAULT


NO_FAULT = Fault(0, "none", "nothing is wrong", "")

DEVICE_FAULTS = (
    Fault(
        1,
        "host_silent",
        "no valid frame came for the watchdog's time",
        "look for a frozen or busy host, and at the cable",
    ),
    Fault(
        2,
        "setpoint_old",
        "a set-point was not refreshed for the watchdog's time",
        "publish set-points at 10 Hz or faster, or send a sequence",
    ),
    Fault(
        3,
        "underrun",
        "a sample of the sequence was missing at its tick",
        "free the host's processors, or use a device with a larger buffer",
    ),
    Fault(
        4,
        "travel_limit",
        "the hub could not have been stopped within its travel",
        "command less travel",
    ),
    Fault(5, "speed_limit", "a command exceeded the speed limit", "command less speed"),
    Fault(6, "acceleration_limit", "a command exceeded the acceleration limit", "command less acceleration"),
    Fault(7, "effort_limit", "a command exceeded the effort limit", "command less effort"),
    Fault(8, "command_not_finite", "a command was not a number", "mend the program that sends it"),
    Fault(9, "session_opened", "a host opened a new session", "use one host at a time"),
    Fault(10, "session_closed", "the host closed the session", "connect again"),
    Fault(
        11,
        "following_error",
        "the hub did not follow its reference",
        "look for a jam, a loose belt or too much load",
        needs_home=True,
    ),
    Fault(12, "end_switch", "an end switch was hit", "look how the hub came there", needs_home=True),
    Fault(
        13,
        "drive_alarm",
        "the motor's drive reports an alarm",
        "read the drive's display, then power-cycle it",
        needs_home=True,
    ),
    Fault(
        14,
        "encoder_lost",
        "the encoder gives no valid position",
        "check the encoder's cable",
        needs_home=True,
    ),
    Fault(
        15, "homing_failed", "home was not found", "check the home switch and the way to it", needs_home=True
    ),
    Fault(
        16,
        "own_watchdog",
        "the controller's processor had stopped and was reset",
        "update the firmware; report how it came about",
        needs_home=True,
    ),
)

HOST_FAULTS = (
    Fault(
        64, "port_unavailable", "the port cannot be opened", "connect the controller, or correct serial.port"
    ),
    Fault(65, "port_lost", "the port vanished", "check cable and power; the driver goes on trying"),
    Fault(
        66,
        "no_answer",
        "nobody answers on the port",
        "check serial.port, serial.baud, the controller's power and its firmware",
    ),
    Fault(67, "wrong_version", "the controller speaks another version", "update the firmware or this suite"),
    Fault(
        68,
        "wrong_axis",
        "the controller is not the axis of the rig file",
        "correct the rig file, or connect the right controller",
    ),
    Fault(
        69,
        "limits_not_obeyed",
        "the controller will not keep the rig's limits",
        "correct the rig file or the firmware; such an axis is never connected",
    ),
    Fault(
        70,
        "watchdog_unproved",
        "the controller did not stop waiting for the silent host in time",
        "mend the firmware's watchdog; axis.prove_watchdog: false goes without the proof",
    ),
    Fault(71, "restarted", "the controller restarted", "check its power"),
    Fault(
        72,
        "session_lost",
        "the controller had forgotten the session",
        "check its power; use one host at a time",
    ),
    Fault(
        73,
        "controller_silent",
        "the controller says nothing any more",
        "check its power and the cable; the driver goes on trying",
    ),
    Fault(
        74,
        "telemetry_stopped",
        "the samples of the hub stopped",
        "check the line's baud rate and the firmware",
    ),
    Fault(
        75, "status_stopped", "the controller's status stopped", "check the line's baud rate and the firmware"
    ),
    Fault(
        76,
        "status_unreadable",
        "the controller speaks, and its answers cannot be read",
        "check serial.baud and its firmware, or update this suite",
    ),
    Fault(
        77,
        "clock_jumped",
        "the controller's clock jumped",
        "switch the controller off and on, and mend its clock",
        needs_home=True,
    ),
    Fault(
        78,
        "clock_backwards",
        "the controller's clock ran backwards",
        "switch the controller off and on, and mend its clock",
        needs_home=True,
    ),
    Fault(
        79,
        "beyond_travel",
        "the hub is beyond its travel",
        "see what pushed it, or whether home has moved",
        needs_home=True,
    ),
    Fault(
        80,
        "position_jumped",
        "the measured position jumped",
        "check the encoder and its cable",
        needs_home=True,
    ),
    Fault(
        81,
        "motion_unexplained",
        "the hub moves as no command explains",
        "look for slip, a loose belt, a wrong encoder or somebody's hand",
    ),
    Fault(
        82,
        "line_flooded",
        "more bytes come than an axis can say",
        "check serial.baud and what is on the port",
    ),
    Fault(83, "host_frozen", "the host's program stood still", "free the host's processors"),
    Fault(
        84, "never_done", "the controller answered `pending` and nothing after it", "restart the controller"
    ),
    Fault(
        85,
        "stop_ignored",
        "the axis did not come to rest when it was asked to",
        "switch the drive off by hand; then mend the controller's stop",
        needs_home=True,
    ),
    Fault(
        86,
        "not_finite",
        "the controller reports NaN or infinity as what it applied",
        "mend the firmware's telemetry",
    ),
    Fault(
        87,
        "other_host",
        "another host takes the controller's session again and again",
        "end one of the two programs that use this port",
    ),
)

FAULTS: dict[int, Fault] = {fault.number: fault for fault in (NO_FAULT, *DEVICE_FAULTS, *HOST_FAULTS)}
"""Every row by its number."""

_BY_NAME = {fault.name: fault for fault in FAULTS.values()}


def fault(name: str) -> Fault:
    """Return the row of a name."""
    return _BY_NAME[name]


def fault_of(number: int) -> Fault:
    """Return the row of a number that came from a device, which may know more rows than this suite."""
    known = FAULTS.get(number)
    if known is not None:
        return known
    return Fault(number, f"fault_{number}", f"the controller's fault {number}", "look it up in its firmware")


def documentation() -> Iterator[str]:
    """Yield the lines of the table in docs/hub-faults.md."""
    yield "| number | name | what has happened | remedy | home |"
    yield "|---|---|---|---|---|"
    for row in (*DEVICE_FAULTS, *HOST_FAULTS):
        home = "again" if row.needs_home else ""
        yield f"| {row.number} | `{row.name}` | {row.sentence} | {row.remedy} | {home} |"
