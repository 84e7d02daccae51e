"""All checks in their order, and what came of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from beam_ros.hub.conformance import (
    bench_checks,
    limit_checks,
    line_checks,
    motion_checks,
    sequence_checks,
    session_checks,
    state_checks,
)
from beam_ros.hub.conformance.check import Check, checks_of
from beam_ros.hub.conformance.dialogue import Bench, DeviceLine, Dialogue
from beam_ros.hub.errors import ConformanceError

ALWAYS: dict[str, str] = {
    "layouts": "sends frames of the protocol's types alone, with bodies that fit",
    "no_restart": "keeps its boot id, as long as it does not restart",
    "never_by_itself": "is never enabled without being asked",
    "ticks_forward": "counts its ticks forward",
    "batches": "sends batches of the size that it named, and no tick twice",
    "fault_numbers": "names faults of the table, or of its own from 32 to 63",
}
"""What is looked at all the time."""

_ROOMS = (
    *(session_checks, line_checks, motion_checks, sequence_checks),
    *(state_checks, limit_checks, bench_checks),
)
CHECKS: tuple[Check, ...] = tuple(check for room in _ROOMS for check in checks_of(room))


@dataclass(frozen=True)
class CheckResult:
    """What came of one check.

    Parameters
    ----------
    name, expected : str
        Of the check.
    outcome : {"passed", "failed", "skipped"}
        skipped: it would have moved the axis, or wants to interfere with its sensors.
    reason : str
        Why it failed or was skipped.
    """

    name: str
    expected: str
    outcome: Literal["passed", "failed", "skipped"]
    reason: str = ""


def run_checks(
    line: DeviceLine,
    *,
    moves: bool,
    names: Sequence[str] = (),
    bench: Bench | None = None,
    progress: Callable[[Check], None] | None = None,
) -> Iterator[CheckResult]:
    """Do the checks one after the other, and leave the axis stopped.

    Parameters
    ----------
    line : DeviceLine
        To the device.
    moves : bool
        Whether the axis may move.
    names : sequence of str, optional
        Of the checks to do; by default all.
    bench : Bench, optional
        The axis, where it is not a real one; without it the checks that interfere with its sensors are skipped.
    progress : callable, optional
        Is told which check begins.

    Raises
    ------
    HubConnectionError
        The line was lost.
    """
    host = Dialogue(line, bench)
    try:
        for check in CHECKS:
            if names and check.name not in names:
                continue
            if check.moves and not moves:
                yield CheckResult(check.name, check.expected, "skipped", "it moves the axis")
                continue
            if check.needs_bench and bench is None:
                yield CheckResult(
                    check.name, check.expected, "skipped", "it interferes with the axis's sensors"
                )
                continue
            if progress is not None:
                progress(check)
            yield _result(check, host)
    finally:
        host.leave()
    for name, expected in ALWAYS.items():
        if not names or name in names:
            seen = host.oddities.get(name, "")
            yield CheckResult(name, expected, "failed" if seen else "passed", seen)


def _result(check: Check, host: Dialogue) -> CheckResult:
    try:
        check.run(host)
    except ConformanceError as err:
        return CheckResult(check.name, check.expected, "failed", str(err))
    return CheckResult(check.name, check.expected, "passed")
