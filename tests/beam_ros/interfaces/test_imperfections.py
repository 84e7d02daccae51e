"""Presets of the simulated hardware, and the refusal of keys that would do nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ros.errors import ParameterFileError
from beam_ros.interfaces.imperfections import PRESETS
from beam_ros.interfaces.parameter_files import packaged_defaults
from beam_ros.interfaces.rig_parameters import RIG_PARAMETERS
from beam_ros.rig.rig import Rig

REALISTIC = {"simulation.preset": "realistic"}
EFFORT = {"hub.command_mode": "effort"}


def test_presets_give_every_imperfection_and_the_packaged_rig_is_the_ideal_one() -> None:
    others = {"images", "displacement_noise", "preset", "real_time_factor", "seed"}
    names = {name.partition(".")[2] for name in RIG_PARAMETERS if name.startswith("simulation.")} - others
    defaults = packaged_defaults()
    assert set(RIG_PARAMETERS["simulation.preset"].choices) == set(PRESETS)
    for preset in PRESETS.values():
        assert set(preset) == names
        for name, value in preset.items():
            assert RIG_PARAMETERS[f"simulation.{name}"].check(value) == value
    assert PRESETS["ideal"] == {name: defaults[f"simulation.{name}"] for name in names}


def test_a_preset_gives_its_keys_and_those_beside_it_win() -> None:
    rig = Rig.from_file().with_values({**REALISTIC, "simulation.backlash": 2e-5})
    assert rig.simulation.backlash == 2e-5
    assert rig.simulation.friction_static == PRESETS["realistic"]["friction_static"]
    # What is set later replaces what was there: a key the preset's, a preset all keys.
    assert rig.with_values({"simulation.ripple": 0.0}).simulation.ripple == 0.0
    assert rig.with_values({"simulation.ripple": 0.0}).simulation.backlash == 2e-5
    ideal = rig.with_values({"simulation.preset": "ideal"})
    assert ideal.values == Rig.from_file().values


def test_a_file_with_a_preset_and_one_with_every_key_mean_the_same(tmp_path: Path) -> None:
    short = tmp_path / "short.yaml"
    short.write_text("/**: {ros__parameters: {simulation: {preset: realistic, servo_frequency: 40.0}}}")
    rig = Rig.from_file(short)
    assert rig.simulation.servo_frequency == 40.0
    assert rig.simulation.encoder_noise == PRESETS["realistic"]["encoder_noise"]
    rig.write(tmp_path / "whole.yaml")
    assert Rig.from_file(tmp_path / "whole.yaml").values == rig.values
    assert Rig.from_nested(rig.to_nested()).values == rig.values


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"simulation.friction_coulomb": 1.0},
            "feels no force.*servo_frequency above 0, or hub.command_mode",
        ),
        ({"simulation.friction_viscous": 1.0}, "no effect"),
        (
            {**EFFORT, "simulation.friction_viscous": 1.0, "simulation.friction_viscous_difference": 3.0},
            "at most 2 N s/m on either side of 0, twice their mean simulation.friction_viscous",
        ),
        ({"simulation.end_stops": True}, "no effect"),
        ({"simulation.ripple": 0.1}, "no effect"),
        ({"simulation.backlash": 1e-5}, "no drive"),
        (
            {**EFFORT, "simulation.servo_frequency": 50.0, "simulation.backlash": 1e-5},
            "another hub.command_mode",
        ),
        ({**EFFORT, "simulation.encoder_at": "drive"}, "no drive"),
        ({"simulation.servo_damping": 1.0}, "no servo"),
        ({"simulation.stop_restitution": 0.5}, "no stops"),
        ({"simulation.ripple_period": 0.02}, "no ripple"),
        ({"simulation.images": False, "simulation.full_well": 5000.0}, "no images"),
        ({"simulation.servo_frequency": 50.0, "simulation.servo_damping": 0.01}, "unstable.*lower it"),
        ({**REALISTIC, "hub.period": 0.004}, "expected at most 28.4 Hz"),
        (
            {**EFFORT, "simulation.friction_coulomb": 1.0, "simulation.friction_static": 0.5},
            "at least simulation.friction_coulomb = 1 N",
        ),
    ],
)
def test_a_key_that_would_do_nothing_or_harm_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ParameterFileError, match=words) as caught:
        Rig.from_file().with_values(change)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("mode", ["acceleration", "velocity", "position", "effort"])
@pytest.mark.parametrize("images", [True, False])
def test_the_realistic_preset_goes_with_every_mode(mode: str, images: bool) -> None:
    rig = Rig.from_file().with_values({**REALISTIC, "hub.command_mode": mode, "simulation.images": images})
    assert rig.simulation.friction_coulomb > 0.0


def test_friction_acts_on_a_hub_that_is_pushed() -> None:
    assert Rig.from_file().with_values({**EFFORT, "simulation.friction_coulomb": 1.0})
    assert Rig.from_file().with_values(
        {"simulation.servo_frequency": 50.0, "simulation.friction_coulomb": 1.0}
    )


def test_the_page_shows_the_presets_as_they_are() -> None:
    page = (Path(__file__).parents[3] / "docs" / "simulation.md").read_text(encoding="utf-8")
    for name, value in PRESETS["ideal"].items():
        row = next(line for line in page.splitlines() if line.startswith(f"| `{name}`"))
        shown = [cell.strip() for cell in row.split("|")[2:4]]
        expected = [str(value).lower(), str(PRESETS["realistic"][name]).lower()]
        assert [_value(cell) for cell in shown] == [_value(cell) for cell in expected], row


def _value(cell: str) -> object:
    try:
        return float(cell)
    except ValueError:
        return cell
