"""What a request needs to get through on a line that loses most answers; the rest of it: ``line/test_client.py``."""

from __future__ import annotations

import pytest

from beam_ros.hub.emulated.unruly_line import UnrulyLine
from beam_ros.hub.parameters import AxisParameters
from tests.beam_ros.hub.hub_scenes import LoopbackRig

VELOCITY = AxisParameters(command_mode="velocity", watchdog_s=0.5)


@pytest.mark.first_case
@pytest.mark.parametrize("phase_ns", range(0, 20_000_000, 4_000_000))
@pytest.mark.parametrize("baud", [115_200, 200_000])
def test_a_stop_gets_through_on_a_line_that_its_samples_flood(baud, phase_ns):
    # Answers find room in a part of each batch of 20 ms only, whichever time of it the stop was asked for.
    rig = LoopbackRig(VELOCITY)
    out, back = (UnrulyLine(baud, 1024, seed) for seed in (1, 2))

    def through(line):
        def carry(data):
            line.put(data, rig.steady_ns)
            return line.take(rig.steady_ns)

        return carry

    rig.to_device, rig.to_host = through(out), through(back)
    rig.run(3.0 + phase_ns * 1e-9)
    assert rig.reports[-1].status.state == "fault"
    assert back.n_lost > 10_000
    asked_ns = rig.steady_ns
    assert rig.ask("stop").success
    assert rig.steady_ns - asked_ns < 300_000_000
