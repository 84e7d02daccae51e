"""Which times a node can keep; that nodes, launch files and commands ask is tested where they are."""

from __future__ import annotations

import pytest

from beam_ros.errors import UsageError
from beam_ros.interfaces.graph import NODES, RigKind, nodes_of_rig
from beam_ros.rig.rig import Rig
from beam_ros.rig.time_keeping import check_time, check_time_of_rig, follows_clock

REAL_TIME = Rig.from_file()
HALF = REAL_TIME.with_values({"simulation.real_time_factor": 0.5})


@pytest.mark.parametrize("executable", sorted(NODES))
def test_what_a_device_is_behind_keeps_real_time_and_the_simulator_follows_nobody(executable: str) -> None:
    check_time(executable, REAL_TIME, uses_sim_time=False)
    keeps_real_time = executable in ("hub_driver", "firmware_emulator")
    for rig, uses_sim_time, is_refused in (
        (HALF, False, keeps_real_time),
        (REAL_TIME, True, keeps_real_time or executable == "simulator"),
    ):
        if is_refused:
            with pytest.raises(UsageError, match=f"with {executable}|for {executable}") as caught:
                check_time(executable, rig, uses_sim_time=uses_sim_time)
            assert "expected" in str(caught.value)
        else:
            check_time(executable, rig, uses_sim_time=uses_sim_time)


def test_only_the_simulated_rig_runs_in_another_time_and_all_but_the_simulator_follow_it() -> None:
    check_time_of_rig(RigKind.SIMULATED, HALF)
    for kind in (RigKind.EMULATED, RigKind.REAL):
        check_time_of_rig(kind, REAL_TIME)
        with pytest.raises(UsageError, match=r"real_time_factor is 0\.5"):
            check_time_of_rig(kind, HALF)
    following = {name for name in nodes_of_rig(RigKind.SIMULATED) if follows_clock(name, HALF)}
    assert following == {"vision_tracker", "excitation_generator"}
    assert not any(follows_clock(name, REAL_TIME) for name in NODES)
