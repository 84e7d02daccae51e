"""Sessions with a device that somebody else speaks to as well, in virtual time."""

from __future__ import annotations

import random

import pytest

from beam_ros.hub.contract import HostTime
from beam_ros.hub.emulated.emulator import EmulatedFirmware
from beam_ros.hub.line import protocol
from beam_ros.hub.line.client import HubClient
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters, LinkParameters
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.hub_scenes import DRIFTING, STEADY_START, UNIX_START

PARAMETERS = AxisParameters()
STEP_NS = 1_000_000
LONGEST_S = 3 * (2 * PARAMETERS.watchdog_s + 0.1)
"""Three proofs of the watchdog, each at its slowest: the most that a host waits for another one."""


class SharedDevice:
    """One device, and hosts that all send to it and all hear what it says, as at a port that a server shares."""

    def __init__(self) -> None:
        self.device = EmulatedFirmware(PARAMETERS, RigidPlant(0.8, 1e-3), DRIFTING, boot_id=1)
        self.hosts: dict[str, HubClient] = {}
        self.greetings: dict[str, list[int]] = {}
        self.events: dict[str, list[str]] = {}
        self.statuses: dict[str, list] = {}
        self.steady_ns = STEADY_START
        self._rng = random.Random(5)

    def join(self, name: str) -> None:
        self.hosts[name] = HubClient(PARAMETERS, LinkParameters())
        self.hosts[name].line_opened(self.steady_ns)
        self.greetings[name], self.events[name], self.statuses[name] = [], [], []

    def run(self, seconds: float) -> None:
        for k in range(round(seconds * 1e9) // STEP_NS):
            now_ns = self.steady_ns
            for name in self._rng.sample(sorted(self.hosts), len(self.hosts)):
                host = self.hosts[name]
                if k % 10 == 0:
                    report = host.poll(HostTime(now_ns, now_ns - STEADY_START + UNIX_START))
                    self.statuses[name].append(report.status)
                    self.events[name] += [e.text for e in report.events if e.level == "error"]
                said = host.transmit(now_ns) + host.clock_query(now_ns)
                kinds = [payload[0] for payload in FrameDecoder().feed(said)]
                self.greetings[name] += [now_ns] * kinds.count(protocol.HELLO)
                device_ns = DRIFTING.clock_start_ns + now_ns - STEADY_START
                answer = self.device.exchange(said, device_ns)
                for listener in self.hosts.values():
                    listener.receive(answer, now_ns + 200_000)
            self.steady_ns += STEP_NS

    def state(self, name: str) -> str:
        return self.statuses[name][-1].state


@pytest.fixture(scope="module")
def shared() -> SharedDevice:
    """One host in session, another that joins it for 10 s, and goes."""
    device = SharedDevice()
    device.join("first")
    device.run(2.0)
    assert device.state("first") == "identified"
    device.join("second")
    device.run(10.0)
    return device


@pytest.mark.slow
@pytest.mark.parametrize("name", ["first", "second"])
def test_two_hosts_of_one_device_leave_each_other_time_and_name_each_other(
    shared: SharedDevice, name: str
) -> None:
    # Doubled from 0.2 s to the longest, the pauses leave room for few greetings in 10 s.
    pauses_s = [0.2, 0.4, 0.8]
    assert len(shared.greetings[name]) <= 2 + len(pauses_s) + (10.0 - sum(pauses_s)) / LONGEST_S
    assert shared.statuses[name][-1].counters["connections"] >= 1
    lost = [s for s in shared.statuses[name][500:] if s.state == "disconnected"]
    assert lost
    assert {s.fault.name for s in lost} == {"other_host"}
    assert any("another host" in s.reason for s in lost)
    # One line for the first loss, one for what it means.
    assert len(shared.events[name]) <= 2


@pytest.mark.slow
def test_a_host_whose_rival_has_gone_comes_back_and_forgets_it(shared: SharedDevice) -> None:
    del shared.hosts["second"]
    shared.run(LONGEST_S + 2.0)
    assert shared.state("first") == "identified"
    shared.run(LONGEST_S + 1.0)
    before = len(shared.greetings["first"])
    # A single greeting of somebody else is no rival: the host answers it at once.
    shared.device.exchange(protocol.encode(protocol.Hello()), 0)
    shared.hosts["first"].receive(
        protocol.encode(shared.device._identity(protocol.VERSION)), shared.steady_ns
    )
    shared.run(0.1)
    assert shared.statuses["first"][-1].fault.name == "session_lost"
    shared.run(2.0)
    assert shared.state("first") == "identified"
    assert len(shared.greetings["first"]) == before + 1


def test_an_answer_to_somebody_elses_greeting_begins_no_session() -> None:
    device = SharedDevice()
    device.join("second")
    answer = device.device.exchange(protocol.encode(protocol.Hello()), DRIFTING.clock_start_ns)
    host = device.hosts["second"]
    host.receive(answer, device.steady_ns)
    assert not host._connection.is_in_session
