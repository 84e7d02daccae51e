"""How far a hub can get: random command streams with random faults, and where the plant then was.

A device that could do twenty times what the rig file allows is driven through the real client and the real
protocol, in virtual time; somewhere in every stream something goes wrong: the line, the device's clock or power,
the host's executor or the whole host; or the host is a foreign one that sends frames without any check. The figure
is by how much the plant has left the rig's travel, as a share of what the stop ramp needs from the speed limit.

With ``--lies`` the device itself lies: it ignores stops, says NaN, misses ticks, creeps, sticks or trips. Then the
host must find it in time, by a name that is right, stop the hub, and say what leads back.

    python -m benchmarks.axis_safety --streams 1000 --seed 1
    python -m benchmarks.axis_safety --lies --streams 200
    python -m benchmarks.axis_safety --streams 100 --firmware firmware/build/stm32f405-plant.elf
"""

from __future__ import annotations

import argparse
import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import REQUEST_KINDS, HostTime, HubStatus, RequestKind, SequenceChunk
from beam_ros.hub.emulated.emulator import EmulatedFirmware
from beam_ros.hub.emulated.injected_faults import KINDS, InjectedFault, disturb
from beam_ros.hub.emulated.unruly_line import UnrulyLine
from beam_ros.hub.faults import NO_FAULT, fault
from beam_ros.hub.line import protocol
from beam_ros.hub.line.client import HubClient
from beam_ros.hub.parameters import (
    COMMAND_MODES,
    AxisParameters,
    CommandMode,
    LinkParameters,
    SimulatedDevice,
)
from beam_ros.hub.simulated.plant import RigidPlant
from benchmarks.paced_firmware import PacedFirmware

STEP_NS = 1_000_000
UNIX_NS = 1_700_000_000_000_000_000
START_NS = 5_000_000_000
MASS = 0.8
"""Of the hub [kg]."""
ACCIDENTS = (
    *("none", "corrupt", "drop", "delay", "stall", "reset", "step", "unplug"),
    *("executor frozen", "host stopped", "host dead", "foreign host"),
)


@dataclass(frozen=True)
class Lie:
    """What a device gets wrong, and what the host must make of it.

    Parameters
    ----------
    kind : str
        In ``KINDS``.
    names : tuple of str
        Faults that name it rightly.
    within : float
        Time in which it must be found [s].
    amounts : tuple of (str, float, float)
        Between which its amounts are drawn, by their logarithm where both have one sign.
    """

    kind: str
    names: tuple[str, ...]
    within: float
    amounts: tuple[tuple[str, float, float], ...] = ()

    def drawn(self, rng: random.Random, at: float = 0.0) -> InjectedFault:
        """Return one of its kind, that begins at a time [s since power-on]."""
        amounts = {
            name: math.exp(rng.uniform(math.log(least), math.log(most)))
            if least > 0.0
            else rng.uniform(least, most)
            for name, least, most in self.amounts
        }
        return InjectedFault(self.kind, at, amounts=amounts)


LED: tuple[CommandMode, ...] = ("acceleration", "velocity", "position")
"""Modes in which the command says where the hub must be."""
LIES = (
    Lie("ignored_stop", ("stop_ignored",), 1.5, (("answer", 0.0, 2.0),)),
    Lie("no_number", ("not_finite",), 0.5, (("share", 0.7, 1.0),)),
    Lie("missed_ticks", ("clock_jumped", "motion_unexplained"), 20.0, (("one_in", 100.0, 5000.0),)),
    Lie(
        "lying_encoder",
        ("motion_unexplained", "beyond_travel"),
        10.0,
        (("drift", 0.002, 0.05), ("offset", 0.0, 0.0), ("scale", 1.0, 1.0)),
    ),
    Lie("sticking_axis", ("motion_unexplained",), 8.0),
    Lie(
        "trip",
        ("end_switch", "encoder_lost", "following_error", "drive_alarm"),
        0.5,
        (("number", 11.0, 14.0),),
    ),
)


@dataclass(frozen=True)
class Excursion:
    """What one stream did to the hub.

    Parameters
    ----------
    mode, accident : str
        How it was commanded, and what went wrong.
    beyond : float
        By how much the plant left the travel at the worst [m]; negative: never.
    allowed : float
        What the stop ramp needs from the speed limit [m].
    moved : float
        How far it got from home [share of half the travel].
    speed : float
        Greatest speed [share of the limit].
    is_at_rest : bool
        Whether it stood at the end, seconds after the host's last word.
    """

    mode: str
    accident: str
    beyond: float
    allowed: float
    moved: float
    speed: float
    is_at_rest: bool


def random_axis(rng: random.Random, modes: Sequence[CommandMode] = COMMAND_MODES) -> AxisParameters:
    """Return the default axis, or as often one that nobody has thought of."""
    mode = rng.choice(modes)
    if rng.random() < 0.5:
        return AxisParameters(command_mode=mode)

    def between(least: float, most: float) -> float:
        return math.exp(rng.uniform(math.log(least), math.log(most)))

    speed, acceleration = between(0.05, 2.0), between(0.5, 50.0)
    return AxisParameters(
        travel=between(0.02, 2.0),
        max_speed=speed,
        max_acceleration=acceleration,
        stop_deceleration=acceleration * between(0.3, 2.0),
        encoder_resolution=between(1e-8, 1e-5),
        command_mode=mode,
        watchdog_s=between(0.1, 1.0),
        move_speed=speed * between(0.1, 1.0),
        move_acceleration=acceleration * between(0.1, 1.0),
        homing_speed=speed * between(0.1, 1.0),
        homing_acceleration=acceleration * between(0.1, 1.0),
    )


class Stream:
    """One rig with one accident.

    Parameters
    ----------
    seed : int
        Of everything.
    built : path, optional
        A built firmware for the STM32F405 as the device; nobody can set its clock.
    modes : sequence of str, optional
        Command modes to choose from.
    """

    def __init__(
        self, seed: int, built: Path | None = None, modes: Sequence[CommandMode] = COMMAND_MODES
    ) -> None:
        self._built = built
        self.firmware: EmulatedFirmware | PacedFirmware | None = None
        self.rng = rng = random.Random(seed)
        self.accident = ACCIDENTS[seed % len(ACCIDENTS)]
        self.axis = random_axis(rng, modes)
        self.device = SimulatedDevice(
            initial_position=rng.uniform(-0.4, 0.4) * self.axis.travel, clock_start_ns=777_000_000_000
        )
        self.client = HubClient(self.axis, LinkParameters())
        self.to_device, self.to_host = UnrulyLine(0, 65536, seed), UnrulyLine(0, 65536, seed + 1)
        self.now_ns = START_NS
        self.boots = 0
        self.worst = self.fastest = 0.0
        self.is_running, self.is_polled, self.is_plugged, self.is_stalled = True, True, True, False
        self.setpoint_number = 0
        self.boot(self.device.initial_position)
        self.client.line_opened(self.now_ns)
        self.report = self.client.poll(self.now)

    def boot(self, position: float) -> None:
        """Switch the device on, which could do twenty times what the rig file allows."""
        self.boots += 1
        plant = RigidPlant(MASS, self.axis.period)
        device = replace(self.device, initial_position=position)
        widest = self.axis.widened(20.0)
        self.close()
        self.boot_ns = self.now_ns
        if self._built is not None:
            self.firmware = PacedFirmware(self._built, widest, plant, position, n_starts=self.boots)
            return
        self.boot_ns -= device.clock_start_ns
        self.firmware = EmulatedFirmware(widest, plant, device, boot_id=self.boots)

    def close(self) -> None:
        """Switch the device off."""
        if isinstance(self.firmware, PacedFirmware):
            self.firmware.close()

    @property
    def now(self) -> HostTime:
        """Both clocks of the host."""
        return HostTime(self.now_ns, self.now_ns - START_NS + UNIX_NS)

    def run(self, seconds: float) -> None:
        """Let time go on, a millisecond at a time."""
        for _ in range(round(seconds * 1e9) // STEP_NS):
            self.now_ns += STEP_NS
            if self.is_running:
                self._host()
            heard = b"" if self.is_stalled else self.to_device.take(self.now_ns)
            if not self.is_stalled:
                said = self.firmware.exchange(heard, self.now_ns - self.boot_ns)
                if self.is_plugged:
                    self.to_host.put(said, self.now_ns)
            self.worst = max(self.worst, abs(self.firmware.axis.true_position))
            self.fastest = max(self.fastest, abs(self.firmware.axis.velocity))

    def _host(self) -> None:
        client, now_ns = self.client, self.now_ns
        said = client.transmit(now_ns) + client.clock_query(now_ns)
        if self.is_plugged:
            self.to_device.put(said, now_ns)
        client.receive(self.to_host.take(now_ns), now_ns)
        if client.is_silent(now_ns):
            client.line_lost(fault("controller_silent"), "silence")
            client.line_opened(now_ns)
        if self.is_polled and now_ns % 10_000_000 == 0:
            self.report = client.poll(self.now)

    def command(self) -> None:
        """Ask for something, sensible or not."""
        rng, axis = self.rng, self.axis
        roll = rng.random()
        if roll < 0.9:
            self._setpoint(
                rng.choice((1.0, 1.0, 1.0, 0.3, 1.2)) * rng.choice((-1, 1, 1)) * axis.command_limit
            )
        elif roll < 0.94:
            self._sequence()
        elif roll < 0.97:
            self.client.request(rng.choice(REQUEST_KINDS))
        else:
            self.client.request("clear_fault")
            self.client.request("enable")

    def _setpoint(self, value: float) -> None:
        if self.accident == "foreign host":
            self.setpoint_number = self.setpoint_number % 0xFFFF + 1
            self.to_device.put(protocol.encode(protocol.Setpoint(self.setpoint_number, value)), self.now_ns)
        else:
            self.client.setpoint(self.now.unix_ns, value, self.now)

    def _sequence(self) -> None:
        n = self.rng.randrange(50, 1500)
        size = self.axis.command_limit * self.rng.choice((0.1, 0.5, 1.0, 1.5))
        values: FloatArray = size * np.sin(np.pi * np.arange(n) / (n - 1)) ** 4
        start_ns = self.now.unix_ns + 200_000_000
        count = -(-n // 500)
        for k in range(count):
            part = values[k * 500 : (k + 1) * 500]
            name = f"s{self.now_ns}"
            chunk = SequenceChunk(name, k + 1, count, start_ns, self.axis.period_ns, k * 500, part)
            if self.is_running:
                self.client.load(chunk, self.now)

    def happen(self) -> None:
        """Let the accident begin."""
        rng, kind = self.rng, self.accident
        if kind in ("corrupt", "drop", "delay"):
            amount = (
                {"seconds": rng.uniform(0.01, 0.5)} if kind == "delay" else {"share": rng.uniform(0.001, 0.3)}
            )
            disturbance = InjectedFault(kind, 0.0, amounts=amount)
            for line in (self.to_device, self.to_host):
                line.begin(disturbance)
        elif kind == "stall":
            self.is_stalled = True
        elif kind == "reset":
            self.boot(self.firmware.axis.true_position)
        elif kind == "step" and isinstance(self.firmware, EmulatedFirmware):
            step = InjectedFault("step", 0.0, amounts={"seconds": rng.uniform(-2.0, 2.0)})
            self.firmware.disturb(step, begins=True)
        elif kind == "unplug":
            self.is_plugged = False
        elif kind == "executor frozen":
            self.is_polled = False
        elif kind in ("host stopped", "host dead"):
            self.is_running = False

    def recover(self) -> None:
        """Let it end, but for what does not end."""
        self.is_plugged = self.is_polled = True
        self.is_stalled = False
        self.is_running = self.accident != "host dead"

    def play(self) -> Excursion:
        """Home, enable, command, let the accident happen and pass, and be left alone at the end."""
        self.run(1.2)
        self.client.request("home")
        self.run(0.6 + 2.0 * self.axis.travel / self.axis.homing_speed / 10)
        self.client.request("enable")
        for seconds, event in ((1.0, self.happen), (0.6, self.recover), (1.0, None)):
            for _ in range(round(seconds / 0.02)):
                if self.is_running and self.is_polled:
                    self.command()
                self.run(0.02)
            if event is not None:
                event()
        self.client.request("stop")
        # The stop itself may be half a second under way.
        self.run(1.0 + 2.0 * self.axis.watchdog_s + 2.0 * self.axis.max_speed / self.axis.stop_deceleration)
        axis = self.axis
        return Excursion(
            axis.command_mode,
            self.accident,
            self.worst - axis.position_limit,
            axis.max_speed**2 / (2.0 * axis.stop_deceleration),
            self.worst / axis.position_limit,
            self.fastest / axis.max_speed,
            self.firmware.axis.velocity == 0.0,
        )


@dataclass(frozen=True)
class Finding:
    """What the host made of a lie.

    Parameters
    ----------
    lie : Lie
        What it was.
    name, remedy : str
        Of the fault that the host found.
    after : float
        When, from the lie's beginning or, of an ignored stop, from the order [s].
    rest_after : float
        How long the plant moved from then on, beyond its own ramp [s].
    beyond : float
        By how much the plant left the travel [m].
    is_enabled_again : bool
        Whether the requests of ``HubStatus.way_back`` lead to an enabled axis once the lie is over.
    """

    lie: Lie
    name: str
    remedy: str
    after: float
    rest_after: float
    beyond: float
    is_enabled_again: bool


class LyingStream(Stream):
    """A rig that is commanded gently, and whose device begins to lie."""

    def __init__(self, seed: int) -> None:
        self.lie = LIES[seed % len(LIES)]
        super().__init__(seed, modes=LED if KINDS[self.lie.kind].place == "axis" else COMMAND_MODES)
        self.accident = "none"

    @property
    def status(self) -> HubStatus:
        """What the host knows of the axis."""
        return self.report.status

    def _lie(self, injected: InjectedFault, *, begins: bool) -> None:
        if KINDS[injected.kind].place == "axis":
            disturb(self.firmware.axis, injected, begins=begins)
        else:
            self.firmware.disturb(injected, begins=begins)

    def ask(self, kind: RequestKind) -> bool:
        """Ask for something and wait for the answer."""
        number = self.client.request(kind)
        for _ in range(2000):
            self.run(0.01)
            completed = dict(self.report.completed)
            if number in completed:
                return completed[number].success
        return False

    def _sway(self, seconds: float) -> None:
        """Move about gently, until the time is over or a fault is found."""
        axis, rng = self.axis, self.rng
        end_ns = self.now_ns + round(seconds * 1e9)
        period = rng.uniform(0.3, 1.0)
        if axis.command_mode == "velocity":
            # A way of twice what a hub may lag behind, so that one that sticks is beyond it.
            period = max(period, 2.0 * math.pi * 2.0 * axis.max_following_error / (0.2 * axis.max_speed))
        while self.now_ns < end_ns and self.status.fault is NO_FAULT:
            phase = 2.0 * math.pi * self.now_ns * 1e-9 / period
            value = 0.3 * axis.position_limit * math.sin(phase)
            if axis.command_mode == "velocity":
                value = 0.2 * axis.max_speed * math.cos(phase)
                if abs(self.status.position) > 0.3 * axis.position_limit:
                    value = -math.copysign(value, self.status.position)
            self.client.setpoint(self.now.unix_ns, value, self.now)
            self.run(0.02)

    def _begin_sequence(self) -> None:
        """Begin a sequence of some seconds that moves the hub back and forth, and wait until it moves."""
        axis, n = self.axis, 6000
        t = np.arange(n) * axis.period
        rate = 2.0 * np.pi * self.rng.uniform(0.5, 1.5)
        # x = a (1 - cos(w t)) fades in and out; its size keeps travel, speed and acceleration.
        size = min(
            0.2 * axis.position_limit, 0.2 * axis.max_speed / rate, 0.2 * axis.max_acceleration / rate**2
        )
        # With the fourth power it is at rest at both ends, also where the way is long.
        fade = np.sin(np.pi * np.arange(n) / (n - 1)) ** 4
        path = size * fade * np.sin(rate * t)
        values = {
            "position": path,
            "velocity": np.append(np.diff(path), 0.0) / axis.period,
            "acceleration": np.append(np.diff(path, 2), (0.0, 0.0)) / axis.period**2,
            "effort": MASS * np.append(np.diff(path, 2), (0.0, 0.0)) / axis.period**2,
        }[axis.command_mode]
        start_ns = self.now.unix_ns + 300_000_000
        for k in range(0, n, 500):
            chunk = SequenceChunk(
                "sway", k // 500 + 1, n // 500, start_ns, axis.period_ns, k, values[k : k + 500]
            )
            self.client.load(chunk, self.now)
        self.run(1.5 + self.rng.uniform(0.5, 3.0))
        assert self.status.activity == "sequence", (self.status, self.report.sequences)

    def find(self) -> Finding:
        """Move, let the device lie, and see what the host makes of it."""
        axis, lie = self.axis, self.lie
        self.run(3.0)
        for kind in ("home", "enable"):
            assert self.ask(kind), (kind, self.status)
        # Some lies show on a hub that is held, others on one that moves; a set-point that ages is a stop by itself.
        is_held = lie.kind == "lying_encoder" and axis.command_mode in ("acceleration", "velocity")
        has_sequence = lie.kind == "ignored_stop" or axis.command_mode in ("acceleration", "effort")
        if is_held:
            self.run(1.0)
        elif has_sequence:
            self._begin_sequence()
        else:
            self._sway(self.rng.uniform(0.5, 2.0))
        injected, begun_ns = lie.drawn(self.rng), self.now_ns
        self._lie(injected, begins=True)
        if lie.kind == "ignored_stop":
            self.client.request(self.rng.choice(("stop", "disable")))
        if is_held or has_sequence:
            while self.status.fault is NO_FAULT and self.now_ns < begun_ns + 1e9 * lie.within:
                self.run(0.01)
        else:
            self._sway(lie.within)
        found_ns, name, remedy = self.now_ns, self.status.fault.name, self.status.remedy
        rest_ns = self.now_ns
        ramp_s = abs(self.firmware.axis.velocity) / axis.stop_deceleration
        for _ in range(300):
            self.run(0.01)
            if self.firmware.axis.velocity != 0.0:
                rest_ns = self.now_ns
        self._lie(injected, begins=False)
        if "off and on" in remedy:
            self.boot(self.firmware.axis.true_position)
        self.run(3.0)
        way_back = self.status.way_back
        is_enabled = all(self.ask(kind) for kind in way_back) and self.status.state == "enabled"
        return Finding(
            lie,
            name,
            remedy,
            (found_ns - begun_ns) * 1e-9,
            (rest_ns - found_ns) * 1e-9 - ramp_s,
            self.worst - axis.position_limit,
            is_enabled,
        )


def excursion(seed: int, built: Path | None = None) -> Excursion:
    """Play one stream."""
    stream = Stream(seed, built)
    try:
        return stream.play()
    finally:
        stream.close()


def print_findings(n_streams: int, seed: int) -> None:
    """Let devices lie, and print what was made of it."""
    first = len(LIES) * 1_000 * seed
    findings = [LyingStream(first + k).find() for k in range(n_streams)]
    print("lie            streams  named rightly  found after [s]  moved on [s]  beyond [mm]  enabled again")
    for lie in LIES:
        rows = [found for found in findings if found.lie is lie]
        if rows:
            print(
                f"{lie.kind:13}  {len(rows):7d}  {sum(row.name in lie.names for row in rows):13d}"
                f"  {max(row.after for row in rows):15.2f}  {max(row.rest_after for row in rows):12.2f}"
                f"  {1e3 * max(row.beyond for row in rows):11.2f}"
                f"  {sum(row.is_enabled_again for row in rows):13d}"
            )


def main(argv: list[str] | None = None) -> None:
    """Play the streams and print what was worst."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--streams", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--firmware", type=Path, help="a built firmware for the STM32F405 as the device")
    parser.add_argument("--lies", action="store_true", help="the device lies, and is to be found out")
    options = parser.parse_args(argv)
    if options.lies:
        print_findings(options.streams, options.seed)
        return
    first = options.seed * 1_000_003
    results = [excursion(seed, options.firmware) for seed in range(first, first + options.streams)]
    print("accident          streams  beyond the travel / ramp  speed / limit  reached  at rest")
    for accident in ACCIDENTS:
        rows = [r for r in results if r.accident == accident]
        if rows:
            worst = max(r.beyond / r.allowed for r in rows)
            print(
                f"{accident:16}  {len(rows):7d}  {worst:24.5f}  {max(r.speed for r in rows):13.5f}"
                f"  {max(r.moved for r in rows):7.3f}  {sum(r.is_at_rest for r in rows)}"
            )


if __name__ == "__main__":
    main()
