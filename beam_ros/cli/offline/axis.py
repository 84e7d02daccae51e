"""Look at a motion controller on its line, without nodes: what answers, and does its firmware keep the protocol?

`beam axis probe /dev/ttyACM0`; any port or URL that pyserial knows will do (`socket://localhost:5000`).
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from pathlib import Path

from beam_ros.cli.options import one_of
from beam_ros.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _add_probe(commands)
    _add_conformance(commands)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    return int(arguments.act(arguments))


# beam axis probe ------------------------------------------------------------------------------------------


def _add_probe(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = commands.add_parser(
        "probe",
        help="what answers on a port, and the lines of the rig file for it",
        description="Look what answers on a port, and print the lines of the rig file for it. It asks for a name and "
        "a voltage only; still, switch the motor's power off first: nobody knows what an unknown controller makes of "
        "these bytes.",
    )
    parser.add_argument("url", metavar="URL", help="port or pyserial URL of the controller")
    parser.add_argument(
        "--baud", type=int, nargs="+", metavar="BAUD", help="rates to try (default: the usual ones)"
    )
    parser.add_argument("--write", type=Path, metavar="FILE", help="write a rig file, which must not exist")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(act=_probe)


def _probe(arguments: argparse.Namespace) -> int:
    from beam_ros.hub.line.transport import SerialTransport
    from beam_ros.hub.links.probe import BAUDS, FLOOD_BYTES, best, probe
    from beam_ros.process.strict_json import strict_json

    if arguments.write is not None and arguments.write.exists():
        raise UsageError(f"--write {arguments.write}: exists already; give a file that does not")
    opened: list[SerialTransport] = []

    def open_line(baud: int) -> SerialTransport:
        while opened:
            opened.pop().dispose()
        opened.append(SerialTransport(arguments.url, baud, FLOOD_BYTES))
        opened[-1].open()
        return opened[-1]

    try:
        findings = probe(open_line, tuple(arguments.baud or BAUDS))
    finally:
        while opened:
            opened.pop().dispose()
    found = best(findings)
    rig = {**found.rig, "serial.port": arguments.url, "serial.baud": found.baud} if found.is_usable else {}
    lines = _rig_file(rig, found.advice)
    if arguments.json:
        tried = [{"baud": each.baud, "kind": each.kind, "sentence": each.sentence} for each in findings]
        content = {"url": arguments.url, "kind": found.kind, "sentence": found.sentence, "baud": found.baud}
        print(strict_json({**content, "tried": tried, "rig": rig, "advice": list(found.advice)}, indent=2))
    else:
        for each in findings:
            print(f"{each.baud:>8} baud: {each.sentence}")
        if rig and arguments.write is None:
            print(f"\n{lines}", end="")
    if rig and arguments.write is not None:
        arguments.write.write_text(lines, encoding="utf-8")
        if not arguments.json:
            print(f"wrote {arguments.write}")
    return 0 if found.is_usable else 1


def _rig_file(rig: dict[str, object], advice: tuple[str, ...]) -> str:
    """Return a rig file with some parameters, and as remarks what a person must add."""
    groups: dict[str, list[str]] = {}
    for name, value in rig.items():
        group, _, leaf = name.partition(".")
        groups.setdefault(group, []).append(f"      {leaf}: {_yaml(value)}")
    lines = ["/**:", "  ros__parameters:"]
    for group, members in groups.items():
        lines += [f"    {group}:", *members]
    lines += [f"    # {sentence}" for sentence in advice]
    return "\n".join(lines) + "\n"


def _yaml(value: object) -> str:
    """Return a value as ROS's own reader of YAML takes it: it wants a point in a number with an exponent."""
    if isinstance(value, float) and "e" in repr(value) and "." not in repr(value):
        return repr(value).replace("e", ".0e")
    return f'"{value}"' if isinstance(value, str) else repr(value)


# beam axis conformance ------------------------------------------------------------------------------------


def _add_conformance(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    from beam_ros.hub.conformance.suite import ALWAYS, CHECKS

    names = {check.name: check.expected for check in CHECKS} | ALWAYS
    width = max(map(len, names))
    parser = commands.add_parser(
        "conformance",
        help="whether a firmware keeps docs/protocol.md: named checks, which move the axis a few millimetres",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Check whether a firmware keeps the protocol of docs/protocol.md.\n\n"
        "The axis is homed and moves by up to 5 % of its travel; be at its emergency stop.",
        epilog="checks: the device ...\n"
        + "\n".join(f"  {name:<{width}}  {text}" for name, text in names.items()),
    )
    parser.add_argument("url", metavar="URL", help="port or pyserial URL of the controller")
    parser.add_argument("--baud", type=int, default=921_600, help="bits per second (default: 921600)")
    parser.add_argument("--yes", action="store_true", help="the axis may move")
    parser.add_argument("--no-motion", action="store_true", help="only the checks that move nothing")
    parser.add_argument(
        "--only",
        nargs="+",
        default=(),
        metavar="CHECK",
        type=one_of("check", names),
        help="only these checks",
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(act=_check_conformance)


def _check_conformance(arguments: argparse.Namespace) -> int:
    if arguments.yes == arguments.no_motion:
        raise UsageError(
            "the checks home the axis and move it by up to 5 % of its travel: expected either --yes, or "
            "--no-motion for the checks that move nothing"
        )
    from beam_ros.hub.conformance.suite import run_checks
    from beam_ros.process.strict_json import strict_json

    results = []
    with _PortLine(arguments.url, arguments.baud) as line:
        for result in run_checks(line, moves=arguments.yes, names=arguments.only):
            results.append(result)
            if not arguments.json:
                reason = f": {result.reason}" if result.outcome == "failed" else ""
                print(f"{result.outcome:<8} {result.name}: {result.expected}{reason}", flush=True)
    failed = sum(result.outcome == "failed" for result in results)
    skipped = sum(result.outcome == "skipped" for result in results)
    if arguments.json:
        print(strict_json({"url": arguments.url, "checks": [asdict(result) for result in results]}, indent=2))
    else:
        print(f"{len(results) - failed - skipped} passed, {failed} failed, {skipped} skipped")
    return 1 if failed else 0


class _PortLine:
    """A serial port as the checks need it; implements ``DeviceLine``."""

    def __init__(self, url: str, baud: int) -> None:
        from beam_ros.hub.line.transport import SerialTransport
        from beam_ros.hub.links.probe import FLOOD_BYTES

        self._transport = SerialTransport(url, baud, FLOOD_BYTES)

    def __enter__(self) -> _PortLine:
        self._transport.open()
        return self

    def __exit__(self, *_error: object) -> None:
        self._transport.dispose()

    def send(self, data: bytes) -> None:
        self._transport.write(data)

    def receive(self, timeout_s: float) -> bytes:
        return self._transport.read(timeout_s)[0]

    def now_ns(self) -> int:
        return time.monotonic_ns()
