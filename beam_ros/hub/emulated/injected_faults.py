"""Faults on request: what is to go wrong with an emulated axis, when, and for how long.

A schedule is a list in YAML, times in seconds since the device's power-on::

    - {at: 5.0, fault: corrupt, for: 2.0, share: 0.01, direction: to_host}
    - {at: 9.0, fault: unplug, for: 1.5}
    - {at: 20.0, fault: drift, ppm: 200}

``for`` is left out where the fault lasts for good or happens once. The table ``KINDS`` says what there is.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Literal

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beam_ros.errors import likeliest
from beam_ros.hub.errors import HubParameterError
from beam_ros.hub.simulated.motion import CarriedHub

Place = Literal["line", "clock", "cable", "device", "firmware", "axis"]
Direction = Literal["to_host", "to_device", "both"]
DIRECTIONS: tuple[Direction, ...] = ("to_host", "to_device", "both")


@dataclass(frozen=True)
class Amount:
    """How strong a fault is: its default, what it may be, and its unit."""

    default: float
    least: float
    most: float
    unit: str


@dataclass(frozen=True)
class FaultKind:
    """A row of the table of what can go wrong.

    Parameters
    ----------
    place : str
        line, clock, cable, device, firmware or axis; a simulated hub has only the last one.
    sentence : str
        What happens.
    amounts : mapping of str to Amount
        How strongly.
    happens_once : bool
        Whether it is over as soon as it has happened, so that it takes no ``for``.
    """

    place: Place
    sentence: str
    amounts: Mapping[str, Amount] = field(default_factory=dict)
    happens_once: bool = False


_SHARE = Amount(0.01, 0.0, 1.0, "of all bytes")

KINDS: dict[str, FaultKind] = {
    "corrupt": FaultKind("line", "bits of some bytes are flipped", {"share": _SHARE}),
    "drop": FaultKind("line", "some bytes are lost", {"share": _SHARE}),
    "delay": FaultKind("line", "bytes come later", {"seconds": Amount(0.1, 0.0, 60.0, "s")}),
    "drift": FaultKind("clock", "the clock runs fast", {"ppm": Amount(100.0, -1e4, 1e4, "1e-6")}),
    "step": FaultKind(
        "clock", "the clock is set forward or back", {"seconds": Amount(1.0, -1e6, 1e6, "s")}, True
    ),
    "wrap": FaultKind(
        "clock",
        "the clock names times with so many bits of nanoseconds",
        {"bits": Amount(32, 20, 63, "bits")},
    ),
    "reset": FaultKind("device", "the power is cut for a moment", happens_once=True),
    "unplug": FaultKind("cable", "the cable is pulled, and put in again at the end"),
    "stall": FaultKind("device", "the device hears and says nothing; its ticks go on"),
    "ignored_stop": FaultKind(
        "firmware",
        "stops are ignored, and answered with nothing (0), success (1) or pending (2)",
        {"answer": Amount(1.0, 0.0, 2.0, "of these")},
    ),
    "no_number": FaultKind(
        "firmware", "ticks say NaN for what was applied", {"share": Amount(1.0, 0.0, 1.0, "of all ticks")}
    ),
    "missed_ticks": FaultKind(
        "firmware",
        "one tick in so many is missed, and not counted",
        {"one_in": Amount(500.0, 20.0, 1e6, "ticks")},
    ),
    "trip": FaultKind(
        "firmware",
        "the firmware stops with a fault of its own, by its number in docs/hub-faults.md",
        {"number": Amount(12.0, 1.0, 63.0, "of the table")},
        happens_once=True,
    ),
    "lying_encoder": FaultKind(
        "axis",
        "the encoder reads something else",
        {
            "offset": Amount(0.001, -10.0, 10.0, "m"),
            "scale": Amount(1.0, -10.0, 10.0, "1"),
            "drift": Amount(0.0, -10.0, 10.0, "m/s"),
        },
    ),
    "sticking_axis": FaultKind("axis", "the hub stands still whatever is commanded"),
}
"""What can be asked for, by its name in a schedule."""


@dataclass(frozen=True)
class InjectedFault:
    """One entry of a schedule.

    Parameters
    ----------
    kind : str
        Key of ``KINDS``.
    at : float
        When it begins [s since power-on].
    duration : float
        How long it lasts [s]; infinite: for good.
    direction : str
        Of the bytes that a line's fault meets.
    amounts : mapping of str to float
        All of the kind's.
    """

    kind: str
    at: float
    duration: float = math.inf
    direction: Direction = "both"
    amounts: Mapping[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return it as a line for a log."""
        amounts = ", ".join(f"{name} {value:g}" for name, value in self.amounts.items())
        lasting = "" if math.isinf(self.duration) else f" for {self.duration:g} s"
        return f"{self.kind}{lasting}{f' ({amounts})' if amounts else ''}"


def read_schedule(text: str, source: str, now: float = 0.0) -> tuple[InjectedFault, ...]:
    """Return the faults that a YAML text asks for.

    Parameters
    ----------
    text : str
        A list of entries, or one entry; empty: none.
    source : str
        Where it comes from, for messages.
    now : float, optional
        What the times of the entries count from [s since power-on].

    Raises
    ------
    HubParameterError
        No YAML, no list of entries, an unknown fault, a number out of its range.
    """
    try:
        entries = YAML(typ="safe", pure=True).load(text)
    except YAMLError as err:
        raise HubParameterError(
            f"{source} is no YAML ({err}); expected entries as {{at: 5.0, fault: reset}}"
        ) from err
    if entries is None:
        return ()
    if isinstance(entries, dict):
        entries = [entries]
    if not (isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)):
        raise HubParameterError(f"{source} holds {entries!r}: expected a list of {{at: 5.0, fault: reset}}")
    return tuple(_read_entry(entry, f"{source}, entry {k}", now) for k, entry in enumerate(entries, start=1))


def read_schedule_file(path: str) -> tuple[InjectedFault, ...]:
    """Return the faults of a schedule's file; none where the path is empty.

    Raises
    ------
    HubParameterError
        The file cannot be read, or is no schedule.
    """
    if not path:
        return ()
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as err:
        raise HubParameterError(
            f"schedule of faults {path} cannot be read: {err}; correct faults.schedule"
        ) from err
    return read_schedule(text, path)


def _read_entry(entry: Mapping[object, object], source: str, now: float) -> InjectedFault:
    name = str(entry.get("fault"))
    kind = KINDS.get(name)
    if kind is None:
        guess = likeliest(name, KINDS)
        raise HubParameterError(
            f"{source} asks for the fault {name!r}: expected one of {', '.join(KINDS)}"
            + (f"; did you mean {guess}?" if guess else "; correct it")
        )
    allowed = {"fault", "at", *kind.amounts}
    allowed |= set() if kind.happens_once else {"for"}
    allowed |= {"direction"} if kind.place == "line" else set()
    for key in entry:
        if key not in allowed:
            raise HubParameterError(
                f"{source} has {key!r}: {name} takes {', '.join(sorted(allowed))}; remove it"
            )
    direction = entry.get("direction", "both")
    if direction not in DIRECTIONS:
        raise HubParameterError(
            f"{source} has direction {direction!r}: expected one of {', '.join(DIRECTIONS)}"
        )
    amounts = {
        what: _number(entry.get(what, amount.default), what, source, amount.least, amount.most)
        for what, amount in kind.amounts.items()
    }
    begins = _number(entry.get("at", 0.0), "at", source, 0.0, 1e9)
    lasts = math.inf if "for" not in entry else _number(entry["for"], "for", source, 0.0, 1e9)
    return InjectedFault(name, now + begins, lasts, direction, amounts)


def _number(value: object, name: str, source: str, least: float, most: float) -> float:
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not least <= value <= most:
        raise HubParameterError(
            f"{source} has {name} {value!r}: expected a number from {least:g} to {most:g}; correct it"
        )
    return float(value)


class FaultSchedule:
    """Faults in the order of their time.

    Parameters
    ----------
    faults : sequence of InjectedFault, optional
        In any order.
    """

    def __init__(self, faults: Sequence[InjectedFault] = ()) -> None:
        self._changes: list[tuple[float, int, InjectedFault, bool]] = []
        self._notes: list[str] = []
        self._numbers = count()
        self.add(faults)

    def add(self, faults: Sequence[InjectedFault]) -> None:
        """Take more faults."""
        for fault in faults:
            heapq.heappush(self._changes, (fault.at, next(self._numbers), fault, True))
            if not math.isinf(fault.duration):
                heapq.heappush(self._changes, (fault.at + fault.duration, next(self._numbers), fault, False))

    def changes(self, now: float) -> Iterator[tuple[InjectedFault, bool]]:
        """Yield what begins (True) or ends (False) up to a time [s since power-on], each once."""
        while self._changes and self._changes[0][0] <= now:
            _, _, fault, begins = heapq.heappop(self._changes)
            self._notes.append(f"{'fault' if begins else 'end of fault'}: {fault}")
            yield fault, begins

    def take_notes(self) -> list[str]:
        """Return what began and ended since the last call, for the log."""
        notes, self._notes = self._notes, []
        return notes


def disturb(axis: CarriedHub, fault: InjectedFault, *, begins: bool) -> None:
    """Let a fault of the axis begin or end; after a restart of the device it is over."""
    if fault.kind == "sticking_axis":
        axis.stick(is_stuck=begins)
    elif begins:
        axis.lie(fault.amounts["offset"], fault.amounts["scale"], fault.amounts["drift"])
    else:
        axis.lie(0.0, 1.0)


def documentation() -> Iterator[str]:
    """Yield the lines of the table of faults that can be asked for, as docs/faults-on-request.md prints it."""
    yield "| fault | what happens | amounts, and what they are when left out |"
    yield "|---|---|---|"
    for name, kind in KINDS.items():
        amounts = [
            f"`{key}` {a.default:g} {a.unit}, {a.least:g} to {a.most:g}" for key, a in kind.amounts.items()
        ]
        if kind.place == "line":
            amounts.append("`direction` both, to_host or to_device")
        if not kind.happens_once:
            amounts.append("`for`: for good")
        yield f"| `{name}` | {kind.sentence} | {'; '.join(amounts)} |"
