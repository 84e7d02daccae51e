from __future__ import annotations

import random
import time

import numpy as np
import pytest

from beam_ros.hub.emulated.controller import EmulatedController
from beam_ros.hub.emulated.emulator import EmulatedFirmware
from beam_ros.hub.line import protocol
from beam_ros.hub.line.framing import FrameDecoder
from beam_ros.hub.parameters import AxisParameters, SimulatedDevice
from beam_ros.hub.simulated.plant import RigidPlant
from tests.beam_ros.hub.hub_scenes import DriverRig

PARAMETERS = AxisParameters()
LIMITS = protocol.DeviceLimits.of(PARAMETERS)


def talk(firmware, messages, device_ns):
    data = b"".join(protocol.encode(m) for m in messages)
    answer = firmware.exchange(data, device_ns)
    return [protocol.decode(p) for p in FrameDecoder().feed(answer)]


def in_session() -> EmulatedFirmware:
    firmware = EmulatedFirmware(PARAMETERS, RigidPlant(0.8, 1e-3), SimulatedDevice(), boot_id=5)
    identity, status = talk(firmware, [protocol.Hello()], 0)
    assert (identity.boot_id, status.state) == (5, "identified")
    assert talk(firmware, [protocol.SetLimits(1, LIMITS)], 0) == [protocol.LimitsReply(1, LIMITS)]
    return firmware


def test_the_device_is_silent_until_it_is_greeted_and_says_who_it_is_when_spoken_to():
    firmware = EmulatedFirmware(PARAMETERS, RigidPlant(0.8, 1e-3), SimulatedDevice(), boot_id=5)
    assert talk(firmware, [], 10**8) == []
    (identity,) = talk(firmware, [protocol.Heartbeat(), protocol.Heartbeat()], 2 * 10**8)
    assert isinstance(identity, protocol.Identity)
    assert firmware.axis.state == "identified"


def test_a_host_of_another_version_is_told_which_one_the_device_speaks():
    firmware = EmulatedFirmware(PARAMETERS, RigidPlant(0.8, 1e-3), SimulatedDevice(), boot_id=5)
    (identity,) = talk(firmware, [protocol.Hello(3, 4)], 0)
    assert (identity.version, identity.lowest_version, identity.highest_version) == (0, 2, 2)


def test_telemetry_is_pushed_every_twenty_ticks_while_the_host_lives():
    firmware = in_session()
    batches = []
    for k in range(1, 300):
        messages = [protocol.Heartbeat()] if k < 100 else []
        for answer in talk(firmware, messages, k * 10_000_000):
            if isinstance(answer, protocol.Telemetry):
                batches.append(answer.ticks)
    assert {len(b) for b in batches} == {20}
    firsts = [b.first_tick for b in batches]
    assert firsts == list(range(0, 20 * len(firsts), 20))
    # A second after the last sign of life at 0.99 s.
    assert 1960 <= firsts[-1] <= 2000


def test_the_answer_to_a_clock_query_is_the_clock():
    firmware = in_session()
    answers = talk(firmware, [protocol.ClockQuery(17)], 123_456_789)
    assert protocol.ClockReply(17, 123_456_789, 123_456_789) in answers


def test_a_repeated_request_is_done_once_and_answered_again():
    firmware = in_session()
    first = talk(firmware, [protocol.Request(1, "home")], 0)
    assert protocol.RequestReply(1, "pending", "") in first
    done = talk(firmware, [protocol.Heartbeat()], 50_000_000)
    assert protocol.RequestReply(1, "success", "homed") in done
    again = talk(firmware, [protocol.Request(1, "home")], 51_000_000)
    assert protocol.RequestReply(1, "success", "homed") in again
    assert firmware.axis.activity == "idle"


def test_nothing_on_the_line_moves_or_breaks_the_device():
    firmware = in_session()
    rng = random.Random(11)
    for k in range(2000):
        firmware.exchange(rng.randbytes(rng.randint(0, 200)), k * 1_000_000)
    assert firmware.axis.state == "identified"
    assert talk(firmware, [protocol.Hello()], 3 * 10**9)[0].boot_id == 5


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e9])
def test_setpoints_out_of_range_are_counted_and_not_followed(value):
    firmware = in_session()
    talk(firmware, [protocol.Request(1, "home")], 0)
    talk(firmware, [protocol.Request(2, "enable")], 20_000_000)
    answers = talk(firmware, [protocol.Setpoint(1, value)], 21_000_000)
    assert answers[-1].setpoints_refused == 1
    assert firmware.axis.state == "enabled"
    assert firmware.axis.activity == "hold"


def test_samples_out_of_order_wait_for_those_before_them():
    firmware = in_session()
    talk(firmware, [protocol.Request(1, "home")], 0)
    talk(firmware, [protocol.Request(2, "enable")], 20_000_000)
    answers = talk(firmware, [protocol.Arm(1, 500_000_000, 200)], 21_000_000)
    assert protocol.ArmReply(1, True, "sequence armed") in answers
    late, early = protocol.Samples(1, 50, np.zeros(50)), protocol.Samples(1, 0, np.zeros(60))
    assert talk(firmware, [late], 22_000_000)[-1].received == 0
    assert talk(firmware, [early], 23_000_000)[-1].received == 60
    # The overlap is dropped, the rest is taken.
    assert talk(firmware, [late], 24_000_000)[-1].received == 100
    assert talk(firmware, [late], 25_000_000)[-1].received == 100


def test_the_camera_sees_the_emulated_axis_at_host_stamps(tmp_path):
    device = SimulatedDevice(clock_drift_ppm=35.0, clock_start_ns=42_000_000_000)
    rig = DriverRig(AxisParameters(command_mode="velocity"), tmp_path, device=device)
    try:
        rig.connect()
        rig.enable()
        rig.hub.setpoint(rig.now.unix_ns, 0.02, rig.now)
        reports = rig.run(0.3)
        batch = next(b for r in reports for b in r.measured if abs(b.velocities[0] - 0.02) < 1e-3)
        shown = rig.emulator.snapshots([batch.stamp_ns])
        # The driver's map and the true one differ by some ten microseconds: at 20 mm/s that is below 2 um.
        assert shown.positions[0] == pytest.approx(batch.positions[0], abs=2e-6)
        assert abs(rig.emulator.reached_ns - time.time_ns()) < 50_000_000
    finally:
        rig.close()


def test_the_link_points_at_the_port_and_goes_with_the_emulator(tmp_path):
    emulator = EmulatedController(PARAMETERS, RigidPlant(0.8, 1e-3), link=tmp_path / "hub")
    first = (tmp_path / "hub").resolve()
    assert str(first).startswith("/dev/pts/")
    emulator.unplug()
    emulator.plug()
    assert (tmp_path / "hub").is_symlink()
    emulator.close()
    assert not (tmp_path / "hub").is_symlink()


def test_a_link_that_cannot_be_made_is_explained(tmp_path):
    (tmp_path / "hub").write_text("a file")
    with pytest.raises(OSError, match=r"emulator\.port_link"):
        EmulatedController(PARAMETERS, RigidPlant(0.8, 1e-3), link=tmp_path / "hub")
