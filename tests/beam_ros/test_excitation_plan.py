"""The excitation against the hub's limits and the beam's predicted motion."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.errors import UsageError
from beam_ros.excitation_plan import plan_excitation, tip_guard
from beam_ros.rig import Rig


def test_the_default_chirp_keeps_the_tip_within_linear_theory() -> None:
    plan = plan_excitation(Rig.from_file())
    # 18.5 mm in mode 1 by the one-mode estimate for 0.7 m/s^2 over 20 s without gravity; upright a little more.
    assert 0.018 < plan.prediction.tip_deflection < 0.022
    assert np.max(np.abs(plan.sampled.positions)) <= 0.005
    assert np.max(np.abs(plan.sampled.accelerations)) <= 0.7 * (1 + 1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"excitation.acceleration": 2.0}, "hub.max_tip_deflection"),
        ({"excitation.acceleration": 12.0, "excitation.start_frequency": 90.0}, "peak acceleration"),
        ({"hub.travel": 0.005}, "peak travel"),
        ({"hub.max_speed": 0.01}, "peak speed"),
        ({"hub.max_effort": 0.1}, "hub.max_effort"),
        ({"beam.max_root_strain": 1e-4}, "beam.max_root_strain"),
    ],
)
def test_what_leaves_a_limit_is_refused_with_the_limit_named(change: dict[str, object], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        plan_excitation(Rig.from_file().with_values(change))


@pytest.mark.parametrize("kind", ["chirp", "multisine", "step"])
@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position", "effort"])
def test_every_signal_in_every_mode_passes_the_hubs_own_guard(kind: str, mode: str) -> None:
    rig = Rig.from_file().with_values(
        {
            "excitation.kind": kind,
            "hub.command_mode": mode,
            "excitation.duration": 4.0,
            "excitation.still": 1.0,
            "excitation.acceleration": 0.2,
        }
    )
    plan = plan_excitation(rig)
    assert tip_guard(rig)(plan.values) is None
    assert np.all(np.isfinite(plan.values))


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position"])
def test_the_guard_refuses_a_resonant_sequence_in_every_mode(mode: str) -> None:
    rig = Rig.from_file().with_values({"hub.command_mode": mode})
    t = np.arange(8000) * 1e-3
    omega = rig.beam_model().natural_frequencies[0]
    x = 1e-3 * np.sin(omega * t)
    values = {"position": x, "velocity": np.gradient(x, t), "acceleration": -(omega**2) * x}[mode]
    assert "predicted tip" in str(tip_guard(rig)(values))


def test_a_plan_describes_itself_completely() -> None:
    rig = Rig.from_file()
    info = plan_excitation(rig).info(rig)
    assert info["recipe"]["kind"] == "log_chirp"
    assert info["hold"] == "zoh"
    assert Rig.from_nested(info["rig"]) == rig
