from __future__ import annotations

import numpy as np
import pytest

from beam_ros.rig.rig import Rig
from tests.beam_ros.hub.hub_scenes import rest_to_rest


def loads_of(rig: Rig, pieces: list[np.ndarray], **start: object):
    loads = rig.beam_guard().sequence(**start)
    for piece in pieces:
        assert loads.add(piece) is None
    return loads.loads


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position", "effort"])
def test_a_sequence_in_pieces_bends_the_beam_as_the_whole_does(mode: str) -> None:
    rig = Rig.from_file().with_values({"hub.command_mode": mode})
    a = rest_to_rest(2000)
    values = {"velocity": np.cumsum(a) * 1e-3, "position": np.cumsum(np.cumsum(a)) * 1e-6}.get(mode, a)
    values = values + (0.01 if mode == "position" else 0.0)
    whole = loads_of(rig, [values], position=0.01)
    pieces = loads_of(rig, np.split(values, [1, 2, 900]), position=0.01)
    assert pieces.tip_deflection == pytest.approx(whole.tip_deflection, rel=1e-9)
    assert pieces.root_strain == pytest.approx(whole.root_strain, rel=1e-9)
    assert pieces.hub_force == pytest.approx(whole.hub_force, rel=1e-9)


def test_all_motions_of_one_move_bend_the_beam_alike() -> None:
    a = rest_to_rest(2000)
    values = {"acceleration": a, "velocity": np.cumsum(a) * 1e-3}
    values["position"] = np.concatenate([[0.0], np.cumsum(np.cumsum(a))]) * 1e-6
    tips = [
        loads_of(Rig.from_file().with_values({"hub.command_mode": mode}), [samples]).tip_deflection
        for mode, samples in values.items()
    ]
    assert tips == pytest.approx(tips[:1] * 3, rel=1e-3)


def test_a_beam_that_still_rings_adds_to_what_follows() -> None:
    rig = Rig.from_file()
    ringing = np.zeros(rig.beam_guard().led.n_states)
    ringing[0] = 5e-3
    still = loads_of(rig, [rest_to_rest(2000)]).tip_deflection
    moved = loads_of(rig, [rest_to_rest(2000)], beam=ringing).tip_deflection
    assert moved > still + 1e-3


def test_a_force_that_would_leave_the_travel_is_refused() -> None:
    """1 N moves 0.83 kg by 0.05 m in 0.29 s."""
    rig = Rig.from_file().with_values({"hub.command_mode": "effort"})
    assert rig.beam_guard().sequence().add(np.full(270, 1.0)) is None
    assert "free hub to 0.0" in str(rig.beam_guard().sequence().add(np.full(310, 1.0)))
    assert "travel" in str(rig.beam_guard().sequence(position=0.02).add(np.full(270, 1.0)))
    fast = Rig.from_file().with_values({"hub.command_mode": "effort", "hub.travel": 1.0})
    assert "m/s" in str(fast.beam_guard().sequence().add(np.full(600, 1.0)))


def test_a_beam_in_air_feels_the_speed_of_its_hub() -> None:
    guard = Rig.from_file().with_values({"beam.air_damping": 0.05}).beam_guard()
    state = np.zeros(guard.led.n_states)
    assert guard.led.n_states == 11
    moving = guard.with_velocity(state, 0.3)
    assert moving[10] == 0.3
    assert state[10] == 0.0
    assert guard.led.peaks(moving, 0.0, 200)[0] > 1e-5
