"""Defects of the firmware's core, one at a time, against the conformance suite: ``python -m tests.firmware.mutants``.

Each is one place of the core that says something else. It is built for this computer and run against the checks in
virtual time, in one command mode after the other, until a check fails. What no check finds is a promise that the
suite certifies without having looked, unless the change is one that nobody can see; then the table says why.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from beam_ros.hub.conformance.suite import run_checks
from beam_ros.hub.parameters import COMMAND_MODES
from tests.beam_ros.hub.conformance.virtual_line import VirtualLine
from tests.firmware.builds import FIRMWARE, VirtualCore

PATIENCE_S = 120
"""After this a core hangs, which somebody would notice: a run of all checks takes seconds."""
COMPILER = ("g++", "-std=c++17", "-O1", "-fno-exceptions", "-fno-rtti", "-ffp-contract=off")


@dataclass(frozen=True)
class Mutant:
    """One defect.

    Parameters
    ----------
    name : str
        What the core does wrong.
    file : str
        Of ``firmware/core``.
    before, after : str
        What stands there, once, and what the defect makes of it.
    equivalent : str
        Why nobody can see it; empty where somebody must.
    """

    name: str
    file: str
    before: str
    after: str
    equivalent: str = ""


def _axis(name: str, before: str, after: str, equivalent: str = "") -> Mutant:
    return Mutant(name, "axis.cpp", before, after, equivalent)


def _core(name: str, before: str, after: str, equivalent: str = "") -> Mutant:
    return Mutant(name, "core.cpp", before, after, equivalent)


def _profiles(name: str, before: str, after: str, equivalent: str = "") -> Mutant:
    return Mutant(name, "profiles.cpp", before, after, equivalent)


def _table(name: str, before: str, after: str) -> Mutant:
    return Mutant(name, "transitions.hpp", before, after)


MUTANTS: tuple[Mutant, ...] = (
    # The watchdog, and what feeds it.
    _axis(
        "the watchdog takes twice its time", "fed_tick_ > watchdog_ticks_", "fed_tick_ > 2 * watchdog_ticks_"
    ),
    _axis(
        "the watchdog takes half its time", "fed_tick_ > watchdog_ticks_", "fed_tick_ > watchdog_ticks_ / 2"
    ),
    _axis(
        "the watchdog keeps its widest time",
        "    watchdog_ticks_ = whole_periods(limits_.watchdog_ns, settings_.period_ns);\n",
        "",
    ),
    _core(
        "frames that do not fit feed the watchdog",
        "    if (!is_whole) {\n        return;",
        "    if (!is_whole) {\n        axis_.feed();\n        return;",
    ),
    _core(
        "only heartbeats feed the watchdog",
        "    axis_.feed();\n",
        "    if (type == heartbeat) axis_.feed();\n",
    ),
    _core(
        "set-points do not feed the watchdog",
        "    axis_.feed();\n",
        "    if (type != setpoint) axis_.feed();\n",
    ),
    Mutant(
        "a frame's CRC is not looked at",
        "framing.cpp",
        "crc32(buffer_, size - 4) == check ? size - 4 : 0",
        "crc32(buffer_, size - 4) != check + 1 ? size - 4 : 0",
    ),
    _axis("a silence is counted twice", "        ++silences_;\n", "        silences_ += 2;\n"),
    _axis("a silence is counted again and again", "        is_silent_ = true;\n", "        feed();\n"),
    _table(
        "a holding axis stays enabled in silence",
        "row(in({C::holding, C::following}), on({K::emergency_stop, K::silence}), C::stopping, reason_kept)",
        "row(in({C::following}), on({K::emergency_stop, K::silence}), C::stopping, reason_kept), "
        "row(in({C::holding}), on({K::silence}), C::same, 0), "
        "row(in({C::holding}), on({K::emergency_stop}), C::stopping, reason_kept)",
    ),
    _table(
        "a sequence goes on in silence",
        "row(in({C::armed, C::running}), on({K::emergency_stop, K::silence}), C::stopping, "
        "sequence_aborted | reason_kept)",
        "row(in({C::armed, C::running}), on({K::silence}), C::same, 0), "
        "row(in({C::armed, C::running}), on({K::emergency_stop}), C::stopping, sequence_aborted | reason_kept)",
    ),
    # The stop ramp.
    _profiles(
        "the stop ramp is 10 % too weak",
        "limits.stop_deceleration * period_;\n    if (magnitude(velocity) <=",
        "0.9 * limits.stop_deceleration * period_;\n    if (magnitude(velocity) <=",
    ),
    _profiles(
        "the stop ramp is 10 % too strong",
        "limits.stop_deceleration * period_;\n    if (magnitude(velocity) <=",
        "1.1 * limits.stop_deceleration * period_;\n    if (magnitude(velocity) <=",
    ),
    _profiles(
        "a hub that moves towards -x stops at once",
        "velocity < 0.0 ? velocity + step :",
        "velocity < 0.0 ? 0.0 :",
    ),
    _axis(
        "the drive brakes less than is told",
        "    drive_.acceleration = acceleration;\n",
        "    drive_.acceleration = 0.98 * acceleration;\n",
    ),
    # The way home.
    _axis(
        "homing is twice as fast",
        "began_below_home_ ? limits_.homing_speed : -limits_.homing_speed",
        "2.0 * (began_below_home_ ? limits_.homing_speed : -limits_.homing_speed)",
    ),
    _axis(
        "homing accelerates ten times as much",
        "limits_.homing_acceleration * period_;",
        "10.0 * limits_.homing_acceleration * period_;",
    ),
    _axis(
        "the approach to home accelerates ten times as much",
        "limits_.homing_speed, limits_.homing_acceleration);",
        "limits_.homing_speed, 10.0 * limits_.homing_acceleration);",
    ),
    _axis(
        "the approach to home is twice as fast",
        "motion_.velocity, limits_.homing_speed, limits",
        "motion_.velocity, 2.0 * limits_.homing_speed, limits",
        "the edge is passed with the homing speed v, and the approach begins where that is braked, v^2/(2 a) "
        "further: over such a way no time-optimal move gets faster than v",
    ),
    _axis(
        "home is where the switch was seen, not where it changed",
        "reading_.has_home_counter ? encoder_.count_of(reading_.home_counter) : encoder_.count()",
        "encoder_.count()",
    ),
    _axis(
        "home is looked for on the wrong side",
        "began_below_home_ ? limits_.homing_speed : -limits_.homing_speed",
        "began_below_home_ ? -limits_.homing_speed : limits_.homing_speed",
    ),
    _axis(
        "the search for home goes on over twice the travel",
        "seek_start_) > limits_.travel",
        "seek_start_) > 2.0 * limits_.travel",
    ),
    # Accidents of the axis.
    _axis(
        "the end switch at -x is ignored",
        "(reading_.is_at_low_end && motion_.velocity < 0.0)",
        "(reading_.is_at_low_end && motion_.velocity != motion_.velocity)",
    ),
    _axis(
        "the end switch at +x is ignored",
        "(reading_.is_at_high_end && motion_.velocity > 0.0)",
        "(reading_.is_at_high_end && motion_.velocity != motion_.velocity)",
    ),
    _axis(
        "the hub cannot leave an end switch",
        "is_at_low_end && motion_.velocity < 0.0",
        "is_at_low_end && true",
    ),
    _axis(
        "home is believed after an end switch",
        "        is_position_lost_ = true;\n        emergency_stop(Fault::end_switch",
        "        emergency_stop(Fault::end_switch",
    ),
    _axis(
        "an alarm of the drive is ignored",
        "} else if (reading_.has_drive_alarm) {",
        "} else if (reading_.has_drive_alarm && tick_ == 0) {",
    ),
    _axis(
        "home is believed after an alarm of the drive",
        "        is_position_lost_ = true;\n        emergency_stop(Fault::drive_alarm",
        "        emergency_stop(Fault::drive_alarm",
    ),
    _axis("a lost encoder is ignored", "!reading.is_counter_valid || step", "step"),
    _axis("a leap of the encoder towards -x is ignored", "|| step < -greatest_step_", ""),
    _axis(
        "home is believed after the encoder was lost",
        "is_position_lost_ || is_encoder_lost_ ||",
        "is_position_lost_ ||",
    ),
    _axis(
        "lost steps are ignored",
        "} else if (reading_.has_lost_steps) {",
        "} else if (reading_.has_lost_steps && tick_ == 0) {",
    ),
    _axis(
        "home is believed after lost steps",
        " || reading_.has_lost_steps;",
        ";",
    ),
    _axis(
        "the following error may be twice as large",
        "                   settings_.max_following_error) {",
        "                   2.0 * settings_.max_following_error) {",
    ),
    _axis(
        "home is believed after a following error",
        "        is_position_lost_ = true;\n        emergency_stop(Fault::following_error",
        "        emergency_stop(Fault::following_error",
    ),
    _axis("a found home does not restore the position", "        is_position_lost_ = false;\n", ""),
    _axis(
        "an axis is enabled under an alarm",
        "    if (reading_.has_drive_alarm) {\n        return",
        "    if (reading_.has_drive_alarm && kind == Cause::home) {\n        return",
        "an alarm that stopped the axis has lost its position, and one at rest stops it in the tick after enabling",
    ),
    # Set-points.
    _core(
        "set-point number 0 is taken",
        "value = reader.take<double>();\n        is_whole = reader.is_whole() && number != 0;",
        "value = reader.take<double>();\n        is_whole = reader.is_whole();",
    ),
    _axis(
        "a set-point may be twice as old",
        "setpoint_tick_ > watchdog_ticks_",
        "setpoint_tick_ > 2 * watchdog_ticks_",
    ),
    _axis(
        "a set-point may be half as old",
        "setpoint_tick_ > watchdog_ticks_",
        "setpoint_tick_ > watchdog_ticks_ / 2",
    ),
    _core(
        "the same set-point again is a new one",
        "    if (number == setpoint_number_) {\n        return;\n    }\n",
        "",
    ),
    _axis(
        "a position set-point grows old",
        "condition_ == Condition::following && settings_.mode != CommandMode::position &&",
        "condition_ == Condition::following &&",
    ),
    _axis(
        "a set-point may be 1 % beyond its limit",
        "magnitude(value) <= command",
        "magnitude(value) <= 1.01 * command",
    ),
    _axis(
        "a set-point must be 1 % within its limit",
        "magnitude(value) <= command",
        "magnitude(value) <= 0.99 * command",
    ),
    _core("refused set-points are not counted", "        ++setpoints_refused_;\n", ""),
    _profiles("a move is 1 % too fast", "limits.move_speed, limits", "1.01 * limits.move_speed, limits"),
    _profiles(
        "a move accelerates 1 % too much", "limits.move_acceleration);", "1.01 * limits.move_acceleration);"
    ),
    _profiles(
        "a speed is got to 1 % too soon",
        "limits.max_acceleration * period_;\n        return",
        "1.01 * limits.max_acceleration * period_;\n        return",
    ),
    # Limits.
    _profiles(
        "the speed limit is 1 % too wide", "> limits.max_speed * (1.0 + slack)", "> 1.01 * limits.max_speed"
    ),
    _profiles(
        "the speed limit is 1 % too narrow", "> limits.max_speed * (1.0 + slack)", "> 0.99 * limits.max_speed"
    ),
    _profiles(
        "the acceleration limit is 1 % too wide",
        "> limits.max_acceleration * (1.0 + slack)",
        "> 1.01 * limits.max_acceleration",
    ),
    _profiles(
        "the effort limit is 1 % too wide",
        "> limits.max_effort * (1.0 + slack)",
        "> 1.01 * limits.max_effort",
    ),
    _profiles(
        "the travel is 1 % too wide",
        "limits.travel * 0.5 + limits.stop",
        "limits.travel * 0.505 + limits.stop",
    ),
    _profiles(
        "the travel is 5 % too narrow",
        "limits.travel * 0.5 + limits.stop",
        "limits.travel * 0.475 + limits.stop",
    ),
    _profiles(
        "the way that a stop takes is not looked at", " || magnitude(motion.position + braking) > room", ""
    ),
    _profiles(
        "the way that a stop takes is halved",
        "(2.0 * limits.stop_deceleration)",
        "(4.0 * limits.stop_deceleration)",
    ),
    _profiles(
        "the way that a stop takes is doubled",
        "(2.0 * limits.stop_deceleration)",
        "(1.0 * limits.stop_deceleration)",
    ),
    _profiles(
        "a force's effect is not foreseen",
        "motion.velocity = begun + change;",
        "motion.velocity = 0.9 * begun;",
    ),
    _profiles(
        "no number is followed", "if (!std::isfinite(command)) {", "if (command > 1e300 && command < 1e301) {"
    ),
    _axis(
        "limits may be wider than the axis can",
        "least.max_speed = lesser(a.max_speed, b.max_speed);",
        "least.max_speed = a.max_speed;",
    ),
    _axis("an infinite limit is taken", "std::isfinite(value) && value > 0.0", "value > 0.0"),
    _axis(
        "limits change while the hub moves", "appearance().activity != Activity::idle || !is_pos", "!is_pos"
    ),
    # Sessions.
    _axis("limits outlive their session", "    has_limits_ = false;\n", ""),
    _axis("requests outlive their session", "    requests.forget();\n", ""),
    _core("set-points outlive their session", "    setpoint_number_ = 0;\n", ""),
    _core(
        "a new session leaves the axis as it is",
        '    axis_.emergency_stop(Fault::session_opened, "a host opened a new session");\n',
        "",
    ),
    _core(
        "the end of a session leaves the axis as it is",
        '        axis_.emergency_stop(Fault::session_closed, "the host closed the session");\n',
        "",
    ),
    _core("the end of a session is not one", "        is_in_session_ = false;\n", ""),
    _core(
        "the device identifies itself without end",
        "identify_interval_ns = 100'000'000",
        "identify_interval_ns = 10'000'000",
    ),
    _core(
        "telemetry ends after half a second",
        "push_patience_ns = 1'000'000'000",
        "push_patience_ns = 500'000'000",
    ),
    _core(
        "telemetry ends after two seconds",
        "push_patience_ns = 1'000'000'000",
        "push_patience_ns = 2'000'000'000",
    ),
    # Requests.
    Mutant("eight requests are remembered", "requests.hpp", "remembered = 16", "remembered = 8"),
    _core(
        "a repeated request is done again",
        "    Request* known = axis_.requests.find(number);\n",
        "    Request* known = axis_.requests.find(number);\n    if (kind != 2) known = nullptr;\n",
    ),
    _core("a request of a kind that there is not is taken", "small < n_requests", "small <= n_requests"),
    # Sequences.
    _axis(
        "a sequence starts a tick early",
        "start_ns / settings_.period_ns + (start_ns % settings_.period_ns != 0 ? 1 : 0)",
        "start_ns / settings_.period_ns",
    ),
    _axis(
        "a start on a tick is the next one's",
        "start_ns / settings_.period_ns + (start_ns % settings_.period_ns != 0 ? 1 : 0)",
        "start_ns / settings_.period_ns + 1",
    ),
    _axis("a sequence starts a tick late", "tick_ >= ring.start_tick()", "tick_ > ring.start_tick()"),
    _axis(
        "a sequence is accepted while the hub moves",
        "if (motion_.velocity != 0.0) {\n            answer",
        "if (motion_.velocity > 1e9) {\n            answer",
    ),
    _axis("a sequence of one sample is accepted", "n_samples < 2", "n_samples < 1"),
    _axis(
        "a start that has passed is accepted",
        "} else if (start_tick < tick_) {",
        "} else if (start_tick + 1000000 < tick_) {",
    ),
    _table(
        "an underrun holds where it should stop",
        "on({K::underrun}), C::stopping, sequence_underrun | reason_kept",
        "on({K::underrun}), C::holding, sequence_underrun | reason_kept",
    ),
    _axis("an underrun has another number", "Fault::underrun,", "Fault::host_silent,"),
    _core("overlap is applied again", "k < known; ++k", "k < known && known > 1000; ++k"),
    _core(
        "more samples are taken than there is room for",
        "n - known < ring.free() ? n - known : ring.free()",
        "n - known",
    ),
    Mutant(
        "room is named that is not there",
        "sample_ring.hpp",
        "capacity - (n_received_ - n_taken_))",
        "capacity + 100 - (n_received_ - n_taken_))",
    ),
    _core("samples of another sequence are taken", "number == axis_.sequence_number() && axis_", "axis_"),
    # Clock, telemetry and states.
    _core(
        "the clock reads half",
        "        message.put(arrived_ns);\n        message.put(board_.clock_ns());\n",
        "        message.put(arrived_ns / 2);\n        message.put(board_.clock_ns() / 2);\n",
    ),
    _core(
        "ticks are fifty off the clock",
        "message.put(axis_.next_tick());",
        "message.put(axis_.next_tick() + 50);",
    ),
    _axis(
        "a position belongs to the tick after its own",
        "as_count(last_count_from_zero_)",
        "as_count(counts_from_zero())",
    ),
    _axis(
        "a speed is that of the tick alone",
        "as_count((both < 0 ? both - 1 : both + 1) / 2)",
        "as_count(encoder_.step())",
    ),
    _axis(
        "a sample is applied in single precision",
        "is_applied_measured_ ? static_cast<double>(reading.effort) : applied_",
        "static_cast<double>(static_cast<float>(applied_))",
    ),
    _axis(
        "a change waits for a batch",
        "        condition_ = row->goal;\n        ++changes_;\n",
        "        condition_ = row->goal;\n",
    ),
    _core(
        "no status follows samples",
        "            ring.append(reader.take<double>());\n        }\n    }\n    send_status();",
        "            ring.append(reader.take<double>());\n        }\n    }",
    ),
    _axis(
        "a reason outlives enabling",
        "        fault_ = Fault::none;\n        reason_ = Text();\n    }\n    if ((effects & watch",
        "    }\n    if ((effects & watch",
    ),
    _axis(
        "a stopped sequence is done",
        "end_sequence(SequenceState::aborted",
        "end_sequence(SequenceState::done",
    ),
    _table(
        "a fault is left by itself", "on({K::rest}), C::fault, waiting", "on({K::rest}), C::homed, waiting"
    ),
    _table(
        "clear_fault enables",
        "on({K::clear_fault}), C::homed, reason_cleared",
        "on({K::clear_fault}), C::holding, reason_cleared",
    ),
    _table(
        "a faulty axis can be enabled",
        'refused(in({C::fault}), on({K::enable}), "',
        'row(in({C::fault}), on({K::enable}), C::holding, 0, "',
    ),
    _table(
        "an axis without a home can be enabled",
        'refused(in({C::identified, C::homing, C::homing_stops}), on({K::enable}), "',
        'row(in({C::identified}), on({K::enable}), C::holding, 0, "enabled"),\n'
        '    refused(in({C::homing, C::homing_stops}), on({K::enable}), "',
    ),
    _table(
        "a homing that was stopped has homed",
        "on({K::rest}), C::identified, waiting",
        "on({K::rest}), C::homed, waiting",
    ),
    _table(
        "a running sequence can be homed away",
        "refused(in({C::holding, C::following, C::armed, C::running, C::stopping, C::stopping_to_fault}), "
        'on({K::home}), "',
        "row(in({C::running}), on({K::home}), C::homing, homing_begun),\n"
        '    refused(in({C::holding, C::following, C::armed, C::stopping, C::stopping_to_fault}), on({K::home}), "',
    ),
)


class _Hangs(Exception):
    """A core that does not answer."""


def _stop(_signal: int, _frame: FrameType | None) -> None:
    raise _Hangs


class Workshop:
    """A copy of the firmware in which defects are made and undone, and only what they change is compiled."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        for room in ("core", "plant", "host"):
            shutil.copytree(FIRMWARE / room, folder / room)
        self._sources = [*sorted((folder / "core").glob("*.cpp")), folder / "host" / "exchange.cpp"]
        self._compile(self._sources, "whole")

    def build(self, mutant: Mutant) -> Path | None:
        """Return the program with a defect, or None where the compiler refuses it."""
        file = self._folder / "core" / mutant.file
        text = file.read_text()
        assert text.count(mutant.before) == 1, (
            f"{mutant.name}: what it changes stands {text.count(mutant.before)} times"
        )
        file.write_text(text.replace(mutant.before, mutant.after))
        try:
            return self._compile([file] if file.suffix == ".cpp" else self._sources, "mutant")
        except subprocess.CalledProcessError:
            return None
        finally:
            file.write_text(text)

    def _compile(self, sources: list[Path], kind: str) -> Path:
        for source in sources:
            subprocess.run(
                [*COMPILER, "-c", str(source), "-o", str(self._object(source, kind))],
                check=True,
                capture_output=True,
            )
        objects = [
            str(self._object(source, kind if source in sources else "whole")) for source in self._sources
        ]
        program = self._folder / kind
        subprocess.run([COMPILER[0], *objects, "-o", str(program)], check=True)
        return program

    def _object(self, source: Path, kind: str) -> Path:
        return self._folder / f"{source.stem}.{kind}.o"


def killer(program: Path) -> str:
    """Return the check that finds a defect, with the command mode, or nothing."""
    signal.signal(signal.SIGALRM, _stop)
    for number, mode in enumerate(COMMAND_MODES):
        signal.alarm(PATIENCE_S)
        try:
            with VirtualCore(number, program=program) as core:
                for result in run_checks(VirtualLine(core), moves=True, bench=core):
                    if result.outcome != "passed":
                        return f"{result.name} in {mode} mode: {result.reason}"
        except (OSError, _Hangs, ValueError, MemoryError) as err:
            return f"the core ended or hung in {mode} mode ({type(err).__name__})"
        finally:
            signal.alarm(0)
    return ""


def main() -> int:
    """Print what finds each defect; the exit status is 0 where only what nobody can see was not found."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.firmware.mutants", description=__doc__.partition("\n")[0]
    )
    parser.add_argument("--only", metavar="WORDS", default="", help="those whose name has these words")
    options = parser.parse_args()
    chosen = [mutant for mutant in MUTANTS if options.only in mutant.name]
    survivors = []
    with tempfile.TemporaryDirectory(prefix="firmware-mutants-") as folder:
        workshop = Workshop(Path(folder))
        for mutant in chosen:
            program = workshop.build(mutant)
            found = killer(program) if program is not None else "it does not compile"
            if not found and not mutant.equivalent:
                survivors.append(mutant)
            verdict = f"killed    {mutant.name}\n          {found}" if found else f"SURVIVED  {mutant.name}"
            if not found and mutant.equivalent:
                verdict = f"the same  {mutant.name}\n          {mutant.equivalent}"
            print(verdict, flush=True)
    n_same = sum(bool(mutant.equivalent) for mutant in chosen)
    print(
        f"{len(chosen) - n_same - len(survivors)} of {len(chosen) - n_same} killed; "
        f"{n_same} change nothing that is seen"
    )
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
