"""Bags of a short experiment at two levels."""

from __future__ import annotations

from pathlib import Path

import pytest

from beam_ident.report.gates import Gate
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.identification_summary import IdentificationOutcome
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig

SHORT = {"excitation.duration": 6.0, "excitation.still": 1.0, "excitation.end_frequency": 45.0}


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reported") / "first"
    simulate(Rig.from_file().with_values(SHORT), path)
    return path


@pytest.fixture(scope="session")
def second_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("reported") / "second"
    rig = Rig.from_file().with_values({**SHORT, "simulation.seed": 7, "excitation.acceleration": 0.4})
    simulate(rig, path)
    return path


@pytest.fixture(scope="session")
def outcome(bag: Path, second_bag: Path) -> IdentificationOutcome:
    gates = [Gate("clock", "passed", "2 us", "below 50 us")]
    return identification_of_bags(
        bag, validation=second_bag, checked=lambda bag, options: (gates, None), temperature_k=1.5
    )
