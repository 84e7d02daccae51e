"""What answers on a port: the suite's own protocol, an ODrive, a Dynamixel, lines of numbers, noise, or nobody.

Everything that is asked changes nothing: a greeting of the suite's protocol, which stops and opens, properties of an
ODrive, and which Dynamixels there are. What is unknown may still take the bytes for something else, so that a motor's
power should be off.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from beam_ros.hub.errors import HubProtocolError
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.link_parameters import OdriveParameters
from beam_ros.hub.links import dynamixel_protocol, odrive_protocol
from beam_ros.hub.links.csv_lines import CsvReader
from beam_ros.hub.links.odrive import Odrive
from beam_ros.hub.links.query_line import Line, QueryLine

BAUDS = (921_600, 115_200, 57_600, 1_000_000, 460_800, 230_400, 2_000_000, 38_400, 19_200, 9_600)
"""Rates that are tried, the usual ones first."""
FLOOD_BYTES = 2_000_000
"""More bytes in a second than anything that answers says."""
LISTEN_S = 0.3
ANSWER_S = 0.3
ENOUGH_ROWS = 4
"""So many rows of numbers, and more of them than other lines, are no accident."""

Kind = Literal[
    "beam", "beam_other_version", "odrive", "odrive_other_version", "dynamixel", "csv", "noise", "silence"
]
USABLE: tuple[Kind, ...] = ("beam", "odrive", "dynamixel", "csv")
OTHER_VERSIONS: tuple[Kind, ...] = ("beam_other_version", "odrive_other_version")
"""What speaks at this rate, and nothing that a link of the suite's does."""


@dataclass(frozen=True)
class Finding:
    """What answers at one rate.

    Parameters
    ----------
    kind : str
        beam, odrive, either with ``_other_version``, dynamixel, csv, noise or silence.
    baud : int
        Rate of the line.
    sentence : str
        For people.
    rig : mapping
        Rig parameters that follow, by dotted name.
    advice : tuple of str
        What the rig file must say besides, and only a person knows.
    """

    kind: Kind
    baud: int
    sentence: str
    rig: Mapping[str, object] = field(default_factory=dict)
    advice: tuple[str, ...] = ()

    @property
    def is_usable(self) -> bool:
        """Whether an axis link can work with it."""
        return self.kind in USABLE


def probe_line(line: Line, baud: int) -> Finding:
    """Look what answers on an open line.

    Parameters
    ----------
    line : Line
        The open port.
    baud : int
        Its rate, for the finding.
    """
    heard, times = _listen(line, LISTEN_S)
    for look in (_numbers, _beam, _odrive, _dynamixel):
        finding = look(line, baud, heard, times)
        if finding is not None:
            return finding
    if heard:
        return Finding("noise", baud, f"{len(heard)} bytes that are neither numbers nor frames")
    return Finding("silence", baud, "nobody answers")


def probe(open_line: Callable[[int], Line], bauds: tuple[int, ...] = BAUDS) -> list[Finding]:
    """Try rates until something usable answers.

    Parameters
    ----------
    open_line : callable
        Opens the port at a rate.
    bauds : tuple of int
        Rates to try.

    Returns
    -------
    list of Finding
        One for each rate that was tried; only the last can be usable.
    """
    findings: list[Finding] = []
    for baud in bauds:
        findings.append(probe_line(open_line(baud), baud))
        if findings[-1].is_usable or findings[-1].kind in OTHER_VERSIONS:
            break
    return findings


def best(findings: list[Finding]) -> Finding:
    """Return what says most of all that was found."""
    order: tuple[Kind, ...] = (*USABLE, *OTHER_VERSIONS, "noise", "silence")
    return min(findings, key=lambda finding: order.index(finding.kind))


def _listen(line: Line, seconds: float) -> tuple[bytes, list[int]]:
    """Gather what comes in a time; return it, and when each end of a line came [ns]."""
    heard, times = b"", []
    end, left = time.monotonic() + seconds, seconds
    while left > 0.0:
        # The last look is one without waiting: at what came while this process was frozen.
        left = end - time.monotonic()
        data, came_ns = line.read(min(max(left, 0.0), 0.05))
        heard += data
        times += [came_ns] * data.count(b"\n")
    return heard, times


def _numbers(_line: Line, baud: int, heard: bytes, times: list[int]) -> Finding | None:
    reader = CsvReader()
    rows = reader.feed(heard)
    if len(rows) < max(ENOUGH_ROWS, reader.n_bad + 1):
        return None
    table = np.array(rows)
    # A line's end came with the row that it ends.
    came_ns = np.array(times[-len(rows) :], dtype=np.float64)
    clock, tick = _clock_column(table, came_ns)
    others = [k + 1 for k in range(table.shape[1]) if k + 1 != clock]
    position = others[0] if others else 1
    names: dict[str, object] = {
        "csv.position_column": position,
        "csv.clock_column": clock,
        "csv.velocity_column": 0,
    }
    if clock:
        names["csv.clock_tick"] = tick
    said = f"its clock in column {clock} in units of {tick:g} s" if clock else "no clock"
    return Finding(
        "csv",
        baud,
        f"lines of {table.shape[1]} numbers, {said}",
        {"axis.kind": "csv", **names},
        (
            f"csv.position_column: {position} is a guess; look which column moves with the hub",
            "axis.metres_per_unit: measure it, one unit of the position in metres",
        ),
    )


def _clock_column(table: np.ndarray, came_ns: np.ndarray) -> tuple[int, float]:
    """Return the column that grows with the time, counted from 1, and its unit [s]; 0 where there is none."""
    passed_s = (came_ns[-1] - came_ns[0]) * 1e-9
    for k in range(table.shape[1]):
        steps = np.diff(table[:, k])
        if passed_s > 0.0 and np.all(steps > 0.0) and np.ptp(steps) < 0.5 * np.mean(steps):
            unit = passed_s / (table[-1, k] - table[0, k])
            tick = 10.0 ** round(math.log10(unit))
            if 0.5 < unit / tick < 2.0 and tick <= 1.0:
                return k + 1, tick
    return 0, 0.0


def _beam(line: Line, baud: int, _heard: bytes, _times: list[int]) -> Finding | None:
    line.write(protocol.encode(protocol.Hello()))
    answer, _ = _listen(line, ANSWER_S)
    for payload in FrameDecoder().feed(answer):
        try:
            message = protocol.decode(payload)
        except HubProtocolError:
            continue
        if isinstance(message, protocol.Identity):
            line.write(protocol.encode(protocol.Goodbye()))
            return _of_identity(message, baud)
    return None


def _of_identity(identity: protocol.Identity, baud: int) -> Finding:
    if identity.version != protocol.VERSION:
        return Finding(
            "beam_other_version",
            baud,
            f"this suite's protocol, versions {identity.lowest_version} to {identity.highest_version}: expected "
            f"version {protocol.VERSION}; update the firmware",
        )
    widest = identity.widest
    return Finding(
        "beam",
        baud,
        f"this suite's protocol, version {identity.version}: {identity.name}, in {identity.command_mode} mode",
        {
            "axis.kind": "beam",
            "hub.period": identity.period_ns * 1e-9,
            "hub.command_mode": identity.command_mode,
            "hub.encoder_resolution": identity.encoder_resolution,
        },
        (
            f"hub.travel: your axis's, at most {widest.travel:g} m",
            f"hub.max_speed: your axis's, at most {widest.max_speed:g} m/s",
            f"hub.max_acceleration: your axis's, at most {widest.max_acceleration:g} m/s^2",
        ),
    )


def _odrive(line: Line, baud: int, _heard: bytes, _times: list[int]) -> Finding | None:
    # What was asked before may be half a line to it.
    line.write(b"\n")
    queries = QueryLine(line)
    queries.drain()
    odrive = Odrive(queries, OdriveParameters())
    try:
        volts, version = odrive.property("vbus_voltage"), odrive.version()
    except HubProtocolError:
        return None
    objection = odrive_protocol.version_objection(version)
    if objection:
        return Finding("odrive_other_version", baud, objection)
    return Finding(
        "odrive",
        baud,
        f"an ODrive with firmware {'.'.join(map(str, version))} and {volts:.1f} V on its bus",
        {"axis.kind": "odrive", "odrive.axis": 0},
        (
            "axis.metres_per_unit: measure it, the hub's travel in one turn of the motor in metres",
            "axis.accept_no_device_limits: true, when end switches and a current limit are set on the ODrive",
        ),
    )


def _dynamixel(line: Line, baud: int, _heard: bytes, _times: list[int]) -> Finding | None:
    line.write(dynamixel_protocol.encode(dynamixel_protocol.EVERYBODY, dynamixel_protocol.PING))
    heard, _ = _listen(line, ANSWER_S)
    taken = dynamixel_protocol.take_status(heard)
    if taken is None or not dynamixel_protocol.is_sound(taken[0]):
        return None
    status = dynamixel_protocol.decode(taken[0])
    model = int.from_bytes(status.parameters[:2], "little")
    name = dynamixel_protocol.MODELS.get(model, f"servo of model {model}")
    return Finding(
        "dynamixel",
        baud,
        f"a Dynamixel {name} with number {status.servo_id} on its bus",
        {"axis.kind": "dynamixel", "dynamixel.id": status.servo_id},
        (
            "axis.metres_per_unit: measure it, the hub's travel in one turn of the servo in metres",
            "axis.accept_no_device_limits: true, when end switches are there, and limits of current are set",
        ),
    )
