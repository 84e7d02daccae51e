"""The axis in a bag: what was simulated is found, written down, and read again as a rig."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from beam_ident import restore
from beam_ros.bags.errors import BagError
from beam_ros.bags.writing import BagWriter
from beam_ros.offline.axis_bag import axis_record, rig_file_of
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.simulation import simulate
from beam_ros.reporting.identification import report_identification
from beam_ros.rig.rig import Rig

CLOSED = {
    "hub.command_mode": "position",
    "excitation.kind": "moves",
    "excitation.waypoints": [0.02, -0.02, 0.0],
    "excitation.dwell": 0.3,
    "excitation.still": 2.0,
    "simulation.servo_frequency": 20.0,
    "simulation.friction_coulomb": 0.5,
    "simulation.friction_viscous": 2.0,
    "simulation.friction_coulomb_difference": 0.3,
    "simulation.friction_viscous_difference": -1.0,
    "simulation.encoder_noise": 2e-6,
}


@pytest.mark.slow
def test_mass_and_friction_of_a_closed_loop_come_back_as_a_rig_file(tmp_path: Path) -> None:
    rig = Rig.from_file().with_values(CLOSED)
    simulate(rig, tmp_path / "bag")
    found = identification_of_bags(tmp_path / "bag", options=FitOptions(n_modes=1, axis=True, drive_mass=0.2))
    axis = found.axis
    assert axis is not None
    # The simulated drive is stiff: the servo of 20 Hz alone is 0.8 kg (2 pi 20 Hz)^2 = 13 kN/m.
    assert not axis.is_compliant
    assert axis.stiffer_than > 13e3
    # 0.1 % of the mass; friction by four of its deviations.
    assert axis.moving_mass == pytest.approx(rig.beam_model().parameters.total_mass, rel=1e-3)
    assert abs(axis.value("coulomb") - 0.5) < 4.0 * axis.sd("coulomb")
    assert abs(axis.value("viscous") - 2.0) < 4.0 * axis.sd("viscous")
    files = report_identification(found, tmp_path / "report")
    assert files.rig is not None
    told = Rig.from_file(files.rig)
    assert told.simulation.servo_frequency == rig.simulation.servo_frequency
    assert told.hub.mass == pytest.approx(0.8, rel=2e-3)
    assert told.simulation.friction_coulomb == axis.value("coulomb")
    assert told.simulation.friction_viscous == axis.value("viscous")
    # On a level axis a constant force of half the difference is a difference of dry friction.
    assert abs(told.simulation.friction_coulomb_difference - 0.3) < 8.0 * axis.sd("offset")
    assert abs(told.simulation.friction_viscous_difference + 1.0) < 4.0 * axis.sd("viscous_difference")
    assert "moving mass" in files.report.read_text()
    assert "stiffer than" in files.report.read_text()
    stored = json.loads(files.model.read_text())["summary"]["axis"]
    assert restore(stored).summary() == axis.summary()


def test_a_rig_file_is_read_as_what_was_written_however_small(tmp_path: Path) -> None:
    values = {"hub.mass": 0.5, "hub.command_mode": "effort", "simulation.friction_coulomb": 1e-7}
    (tmp_path / "axis.yaml").write_text(rig_file_of(values))
    told = Rig.from_file(tmp_path / "axis.yaml")
    assert {name: told[name] for name in values} == values


def test_a_bag_without_a_force_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "empty"):
        pass
    with pytest.raises(BagError, match="hub/measured"):
        axis_record(tmp_path / "empty", [])
