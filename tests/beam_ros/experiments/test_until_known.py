"""Segments go on until the aims are met; what cannot be reached is said with the time that it would take."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from beam_ident import Aim, InputSignal, ModalModel, OutputSignal, Prior, TimeRecord, aims_of
from beam_ros.errors import UsageError
from beam_ros.excitation.optimal import theory_of_drive
from beam_ros.excitation.recipes import recipe_of_rig
from beam_ros.experiments.until_known import KnownSegment, UntilOutcome, experiment_until, of_length
from beam_ros.offline.loading.experiment import Experiment
from beam_ros.rig.rig import Rig
from tests.beam_ros.conftest import Beam

RIG = Rig.from_file().with_values({"excitation.end_frequency": 20.0, "beam.modes": 2})
TRUTH = theory_of_drive(RIG)
NOISE = 5e-5


@dataclass
class Filmed:
    """A rig without nodes: what its theory shows, with noise."""

    rigs: list[Rig]

    def __call__(self, rig: Rig, number: int) -> Experiment:
        self.rigs.append(rig)
        excitation = recipe_of_rig(rig).sample(rig.hub.period)
        stamps = 0.01 * np.arange(1, int(excitation.duration_s * 100.0) - 1)
        drive = InputSignal("hub", "m", (0.0, rig.hub.period), excitation.positions, "cubic", 1e-9)
        clean = TRUTH.simulate(drive, stamps, rig.camera.exposure)
        seen = clean + NOISE * np.random.default_rng(number).standard_normal(clean.shape)
        outputs = [
            OutputSignal(name, "m", stamps, seen[:, j], rig.camera.exposure)
            for j, name in enumerate(TRUTH.output_names)
        ]
        record = TimeRecord((drive,), tuple(outputs))
        return Experiment(None, record, rig, "base_motion", Prior(0.0, 50e-6), (), {})  # type: ignore[arg-type]


def designed(rig: Rig, criterion: str, identified: ModalModel) -> Any:
    """Stand in for the design, which has tests of its own and takes ten seconds: the chirp again, with a forecast."""
    sds = {"omega_1": 3e-5, "zeta_1": 2e-3}
    known = SimpleNamespace(pole_sd=sds)
    half = SimpleNamespace(pole_sd={name: 2.0 * sd for name, sd in sds.items()})
    return SimpleNamespace(rig=rig, design=SimpleNamespace(optimal=known, chirp=half), criterion=criterion)


@pytest.mark.slow
def test_the_experiment_ends_with_the_segment_that_meets_the_aims() -> None:
    filmed, seen = Filmed([]), []
    outcome = experiment_until(
        RIG, aims_of("f1:0.1%, zeta1:0.15%"), filmed, 60.0, 6.0, design=designed, told=seen.append
    )
    assert outcome.is_known
    assert 1 < len(outcome.segments) == len(filmed.rigs) < 10
    assert list(outcome.segments) == seen
    assert outcome.duration_s == 6.0 * len(filmed.rigs)
    sds = [own.relative_sd["zeta1"] for own in outcome.segments]
    assert sds[-1] <= 0.0015 < sds[-2]
    assert outcome.segments[-1].seconds_to_go == 0.0
    assert outcome.result is not None
    error = outcome.result.model.natural_frequencies[0] - TRUTH.natural_frequencies[0]
    assert abs(error) < 4.0 * outcome.result.model.natural_frequency_sd[0]
    assert "Known as well as was asked" in outcome.sentence
    assert "the best chirps would take about" in outcome.sentence
    assert json.loads(json.dumps(outcome.to_dict()))["segments"][0]["excitation"] == "chirp of the rig"
    assert outcome.segments[1].excitation.startswith("designed (c:zeta_1) from 1 mode")


@pytest.mark.slow
def test_an_aim_that_cannot_be_reached_is_said_with_its_time() -> None:
    outcome = experiment_until(RIG, (Aim("zeta", 1, 1e-5),), Filmed([]), 13.0, 6.0, design=designed)
    assert not outcome.is_known
    assert outcome.duration_s == 12.0
    # Every further segment is said to bring 2e-3: 6 s (2e-3 / 1e-5)^2, less what is there.
    assert outcome.segments[-1].seconds_to_go == pytest.approx(240_000.0, rel=0.01)
    assert "The time is up after 12.0 s in 2 segments. Known is zeta1 to" in outcome.sentence
    assert "0.001 % asked: it would take about 2" in outcome.sentence


@pytest.mark.slow
def test_where_nothing_can_be_designed_the_rigs_own_excitation_goes_on() -> None:
    def none(*_given: object) -> Any:
        raise UsageError("no mode in the band")

    outcome = experiment_until(RIG, (Aim("f", 1, 1e-9),), Filmed([]), 13.0, 6.0, design=none)
    assert outcome.segments[1].excitation == "chirp of the rig, since no mode in the band"


@pytest.mark.slow
def test_what_shows_no_mode_says_so() -> None:
    filmed = Filmed([])

    def still(rig: Rig, number: int) -> Experiment:
        shown = filmed(rig, number)
        noise = np.random.default_rng(number)
        outputs = tuple(
            replace(own, values=NOISE * noise.standard_normal(len(own.values)))
            for own in shown.record.outputs
        )
        return replace(shown, record=replace(shown.record, outputs=outputs))

    outcome = experiment_until(RIG, (Aim("f", 1, 1e-3),), still, 7.0, 6.0, design=designed)
    assert not outcome.is_known
    assert outcome.sentence.startswith("Nothing is known after 6.0 s in 1 segment: ")


def test_a_mode_that_is_not_there_is_known_to_nothing() -> None:
    segment = KnownSegment("chirp", 6.0, 1, {"f1": 1e-4, "f3": math.inf}, math.inf)
    assert segment.known == "f1 to 0.01 %, f3 not at all"
    aims = (Aim("f", 3, 1e-3),)
    outcome = UntilOutcome(aims, (segment,), object(), False, math.nan)  # type: ignore[arg-type]
    assert "f3 not at all, 0.1 % asked: it would take a time that is not known yet" in outcome.sentence


def test_another_length_keeps_the_share_that_is_still() -> None:
    short = of_length(RIG, 6.0)
    assert short.excitation.duration + short.excitation.still == pytest.approx(6.0)
    assert short.excitation.still / 6.0 == pytest.approx(
        RIG.excitation.still / (RIG.excitation.duration + RIG.excitation.still)
    )


@pytest.mark.parametrize(("longest", "segment"), [(5.0, 6.0), (6.0, 0.0)])
def test_a_time_without_a_segment_is_refused(longest: float, segment: float) -> None:
    with pytest.raises(UsageError, match="fits into the time"):
        experiment_until(RIG, (Aim("f", 1, 1e-3),), Filmed([]), longest, segment)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--until", "f1"), "expected f1:0.01%"),
        ((), "expected either a PLAN or --until"),
        (("quick", "--until", "f1:1%"), "expected either a PLAN or --until"),
        (("--until", "f1:1%", "--time", "1"), "fits into the time"),
    ],
)
def test_the_command_refuses_in_one_line(beam: Beam, words: tuple[str, ...], complaint: str) -> None:
    ended = beam("experiment", *words)
    assert ended.returncode == 2
    assert complaint in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1


@pytest.mark.slow
def test_the_command_goes_on_until_the_aims_are_met(beam: Beam) -> None:
    ended = beam("experiment", "--until", "f1:0.01%, zeta1:2%", "--out", "known", "--json")
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert found["is_known"]
    assert found["duration_s"] == 8.0
    assert found["modes"][0]["frequency_sd_hz"] < 1e-4 * found["modes"][0]["frequency_hz"]
