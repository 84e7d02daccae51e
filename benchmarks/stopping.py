"""Does the stated interval still cover where an experiment stops as soon as it is small enough, and what is gained?

    python -m benchmarks.stopping [--runs 200] [--workers 2]

Every run films the packaged rig (fourteen modes from its physics) with fresh noise, in three ways: one chirp that
ends when the growing estimate meets the aims (stopping alone), segments of chirps until the aims are met, and
segments of which all but the first are designed (stopping and design). No DDS, in this process. What is stated at the
end is held against the truth, and against the offline fit of the same samples.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from beam_ident import (
    Aim,
    GrowingIdentification,
    IdentificationError,
    InputSignal,
    ModalModel,
    OutputSignal,
    Prior,
    Recipe,
    TimeRecord,
    aims_of,
    identify,
    map_records,
)
from beam_ros.excitation.optimal import RigDesign, design_for_rig, theory_of_drive
from beam_ros.excitation.recipes import recipe_of_rig
from beam_ros.experiments.until_known import experiment_until, of_length
from beam_ros.offline.loading.experiment import Experiment
from beam_ros.rig.rig import Rig

NOISE_SD = 5e-5
AIMS = "f1:0.01%, zeta1:0.2%, zeta2:10%"  # met while one chirp passes the second mode, or just after
SEGMENT_AIMS = "f1:0.01%, zeta1:0.1%, zeta2:4%"  # met after some segments
TRUE_MODES = 14
LONG_S, SEGMENT_S, LONGEST_S = 30.0, 8.0, 120.0
BEGIN_S, STEP_S = 14.0, 1.0  # before the second mode shows, no estimate can meet the aims
SHOWN = 20  # runs, after which the figures so far are shown
CHIRP = {"excitation.end_frequency": 45.0}


@dataclass(frozen=True)
class Way:
    """How a run went: duration [s], errors over stated deviations, the end beside the offline fit in deviations."""

    duration_s: float
    errors: dict[str, float]
    apart: float


@cache
def _rig() -> Rig:
    return Rig.from_file().with_values(CHIRP)


@cache
def _truth() -> ModalModel:
    return theory_of_drive(_rig().with_values({"beam.modes": TRUE_MODES}))


@cache
def _clean(recipe: Recipe) -> tuple[InputSignal, np.ndarray, np.ndarray]:
    """Return what the hub does, the frames' stamps and what they show without noise."""
    rig, excitation = _rig(), recipe.sample(_rig().hub.period)
    stamps = np.arange(1, int(excitation.duration_s * rig.camera.rate) - 1) / rig.camera.rate
    clean = (
        _truth()
        .driven_by("acceleration")
        .simulate(excitation.input_signal("acceleration"), stamps, rig.camera.exposure)
    )
    drive = InputSignal("hub", "m", (0.0, rig.hub.period), excitation.positions, "cubic", 1e-9)
    return drive, stamps, clean


def _record(recipe: Recipe, seed: tuple[int, ...]) -> TimeRecord:
    drive, stamps, clean = _clean(recipe)
    seen = clean + NOISE_SD * np.random.default_rng(seed).standard_normal(clean.shape)
    names, exposure = _rig().markers.names, _rig().camera.exposure
    outputs = (OutputSignal(n, "m", stamps, seen[:, j], exposure) for j, n in enumerate(names))
    return TimeRecord((drive,), tuple(outputs))


@cache
def _designed(rig: Rig, criterion: str) -> RigDesign:
    """Return the design of theory, once: that of an estimate within the aims hardly differs."""
    return design_for_rig(rig, criterion, None, frequency_sd=1e-3, damping_sd=0.05, noise=NOISE_SD)


def _errors(model: ModalModel, aims: Sequence[Aim]) -> dict[str, float]:
    truth, found = _truth(), {}
    for aim in aims:
        place = int(np.argmin(np.abs(truth.natural_frequencies - model.natural_frequencies[aim.mode - 1])))
        own = (
            ("natural_frequencies", "natural_frequency_sd")
            if aim.quantity == "f"
            else ("damping_ratios", "damping_ratio_sd")
        )
        value, sd = (getattr(model, name)[aim.mode - 1] for name in own)
        found[aim.name] = float((value - getattr(truth, own[0])[place]) / sd)
    return found


def _apart(model: ModalModel, records: list[TimeRecord]) -> float:
    """Return how far an end is from the offline fit of the same samples, in its standard deviations, the most."""
    offline = identify(records, "base_motion").model
    if offline.n_modes != model.n_modes:
        return float("inf")
    n = 2 * model.n_modes
    return float(
        np.max(np.abs(model.parameters[:n] - offline.parameters[:n]) / offline.standard_deviations[:n])
    )


def stopped_chirp(seed: int, aims: Sequence[Aim]) -> Way | None:
    """Stop one long chirp when the growing estimate meets the aims."""
    whole = _record(recipe_of_rig(of_length(_rig(), LONG_S)), (seed, 0))
    growing = GrowingIdentification("base_motion", share_of_core=1e3)
    for end in np.arange(BEGIN_S, LONG_S, STEP_S):
        record = whole.between(0.0, float(end))
        result = growing.grown(record)
        if result is not None and growing.knows(record, aims):
            model = growing.result.model
            return Way(float(end), _errors(model, aims), _apart(model, [record]))
    return None


def segments(seed: int, aims: Sequence[Aim], design: Callable[..., RigDesign]) -> Way | None:
    """Record segments until the aims are met."""
    records = []

    def record(rig: Rig, number: int) -> Experiment:
        records.append(_record(recipe_of_rig(rig), (seed, number)))
        return Experiment(None, records[-1], rig, "base_motion", Prior(0.0, 50e-6), (), {})

    outcome = experiment_until(_rig(), aims, record, LONGEST_S, SEGMENT_S, design=design)
    if not outcome.is_known:
        return None
    return Way(outcome.duration_s, _errors(outcome.result.model, aims), _apart(outcome.result.model, records))


def _as_before(rig: Rig, criterion: str, identified: ModalModel) -> RigDesign:
    """Design nothing: the chirp again."""
    return replace(_designed(rig, criterion), rig=rig)


def _by_theory(rig: Rig, criterion: str, identified: ModalModel) -> RigDesign:
    return _designed(rig, criterion)


WAYS: dict[str, Callable[..., Way | None]] = {
    "one chirp, stopped": stopped_chirp,
    "chirps until known": partial(segments, design=_as_before),
    "designed until known": partial(segments, design=_by_theory),
}


def run(seed: int, ways: Sequence[str]) -> dict[str, Way | None]:
    """Go through one seed in every way."""
    found: dict[str, Way | None] = {}
    for name in ways:
        try:
            found[name] = WAYS[name](seed, aims_of(AIMS if WAYS[name] is stopped_chirp else SEGMENT_AIMS))
        except IdentificationError as err:
            print(f"seed {seed}, {name}: {err}", flush=True)
            found[name] = None
    return found


def summary(runs: Sequence[dict[str, Way | None]]) -> dict[str, Any]:
    """Return coverage of 95 % intervals, durations and agreement, by way."""
    figures = {}
    for name in runs[0]:
        known = [own[name] for own in runs if own[name] is not None]
        if not known:
            continue
        errors = np.array([list(own.errors.values()) for own in known])
        figures[name] = {
            "runs": len(known),
            "not known in time": len(runs) - len(known),
            "coverage [%]": {
                aim: round(100.0 * float(np.mean(np.abs(errors[:, k]) < 1.96)), 1)
                for k, aim in enumerate(known[0].errors)
            },
            "coverage of all [%]": round(100.0 * float(np.mean(np.abs(errors) < 1.96)), 1),
            "largest error [sd]": round(float(np.max(np.abs(errors))), 2),
            "median duration [s]": float(np.median([own.duration_s for own in known])),
            "from offline fit [sd], at most": float(np.max([own.apart for own in known])),
        }
    return figures


def main() -> None:
    """Run the study and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--first", type=int, default=1, help="seed of the first run")
    parser.add_argument("--ways", default=";".join(WAYS), help="which, with ; between")
    arguments = parser.parse_args()
    begun = time.perf_counter()
    ways = arguments.ways.split(";")
    seeds = range(arguments.first, arguments.first + arguments.runs)
    runs: list[dict[str, Way | None]] = []
    for first in range(0, len(seeds), SHOWN):
        runs += map_records(partial(run, ways=ways), seeds[first : first + SHOWN], arguments.workers)
        print(json.dumps(summary(runs), indent=1))
        print(f"{len(runs)} runs, {time.perf_counter() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    main()
