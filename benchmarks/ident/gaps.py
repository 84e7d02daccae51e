"""Films with lost samples of the hub and lost frames: 1 to 50 messages of 20 ms, 0 to 30 % of the frames.

In every second record what is lost stands together.  Where that hides how the sweep passed a mode, all that is left
of it is a decay, which says little of its residues: the bound is not for that.  Without the third, two modes are an
answer, too.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from beam_ident import EstimationError, LogChirp, TimeRecord, identify
from benchmarks.ident.rig import Rig, flat
from benchmarks.ident.study import AgainstBound, Outcome, Study

_MESSAGE = 20  # samples
_MOST_MESSAGES = 50
_MOST_FRAMES = 0.3
_RUNS_OF_BOUND = 12
_PASSING_S = 0.1  # before the sweep is at a mode it already moves it


class Gaps(AgainstBound):
    """Everything of three modes; the bound knows the hub, and lacks the frames that are lost."""

    def __init__(self) -> None:
        chirp = LogChirp(duration=10.0, still=4.0)
        self.rig = Rig(chirp=chirp)
        octaves = np.log(self.rig.full.frequencies_hz[:3] / chirp.start_frequency)
        self.passages_s = chirp.duration * octaves / np.log(chirp.end_frequency / chirp.start_frequency)
        self.truth = self.rig.truth

    def record(self, seed: int, is_hub_whole: bool = False) -> TimeRecord:
        """Return a record with gaps; ``is_hub_whole`` leaves them out of the input."""
        record, rng = self.rig.record(seed), np.random.default_rng([seed, 1])
        drive = record.inputs[0]
        n_messages = len(drive.values) // _MESSAGE
        lost = self._places(rng, n_messages - 4, int(rng.integers(1, _MOST_MESSAGES + 1)), seed % 2 == 1) + 2
        kept = np.ones(len(drive.values), dtype=bool)
        kept[(_MESSAGE * lost[:, None] + np.arange(_MESSAGE)).ravel()] = False
        if not is_hub_whole:  # no NaN: stamps that are not there
            drive = replace(drive, times_s=drive.times_s[kept], values=drive.values[kept])
        n_frames = len(self.rig.stamps)
        unseen = self._places(rng, n_frames, round(rng.uniform(0.0, _MOST_FRAMES) * n_frames), False)
        outputs = []
        for output in record.outputs:
            values = output.values.copy()
            values[unseen] = np.nan
            outputs.append(replace(output, values=values))
        return TimeRecord((drive,), tuple(outputs))

    @staticmethod
    def _places(rng: np.random.Generator, n: int, n_lost: int, is_together: bool) -> np.ndarray:
        if is_together:
            return np.arange(n_lost) + int(rng.integers(0, n - n_lost))
        return np.sort(rng.choice(n, n_lost, replace=False))

    @cached_property
    def bound(self) -> np.ndarray:
        """Root of the mean variance that records state whose hub is known."""
        stated = [
            flat(identify(self.record(10**6 + k, is_hub_whole=True), n_modes=3).model)[1]
            for k in range(_RUNS_OF_BOUND)
        ]
        return np.asarray(np.sqrt(np.mean(np.square(stated), axis=0)))

    def run(self, seed: int) -> Outcome:
        """Identify one record; another number of modes, or gaps that nothing names, are a failure."""
        record = self.record(seed)
        start = time.perf_counter()
        try:
            found = identify(record)
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        seconds = time.perf_counter() - start
        if not any("Input hub has" in said for said in found.warnings):
            return Outcome(seconds)
        gaps = record.inputs[0].gaps
        if any(
            gap.start_s < at_s - _PASSING_S and at_s < gap.end_s for gap in gaps for at_s in self.passages_s
        ):
            return Outcome(seconds, figures={"hidden": 1.0, "modes": float(found.model.n_modes)})
        return Outcome(seconds, *flat(found.model)) if found.model.n_modes == 3 else Outcome(seconds)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Set those records aside whose gap hides a mode."""
        hidden = [own.figures["modes"] for own in outcomes if own.figures]
        shown = [seed for seed, own in enumerate(outcomes) if not own.figures]
        told = super().summarise([outcomes[seed] for seed in shown])
        if "failed seeds" in told:
            told["failed seeds"] = [shown[place] for place in told["failed seeds"]]
        return told | {
            "hidden": len(hidden),
            "two modes of them": hidden.count(2.0),
            "three": hidden.count(3.0),
        }


STUDIES = {"gaps": Study("1 to 50 lost messages of the hub, 0 to 30 % of the frames", 200, Gaps)}
