"""Structures with a dozen modes between 2 and 15 Hz: all of them, and nothing else, without a hint."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from beam_ident import InputSignal, ModalModel, OutputSignal, TimeRecord, identify, validate
from benchmarks.ident.study import Outcome, Study


class ManyModes:
    """A structure of close modes under a random force, drawn anew from every seed; 50 samples a second for 120 s.

    Damping ratios of 1 to 5 % let the resonances overlap: a fit of a few of them has no clear optimum.
    """

    period, n, n_modes = 0.02, 6000, 12
    band_hz = (2.0, 15.0)

    def __init__(self, seed: int, snr_db: float, n_outputs: int) -> None:
        rng = np.random.default_rng([seed, self.n_modes])
        middles = np.geomspace(*self.band_hz, self.n_modes)
        ratio = middles[1] / middles[0]
        frequencies = np.sort(middles * ratio ** rng.uniform(-0.25, 0.25, self.n_modes))
        omegas, zetas = 2.0 * np.pi * frequencies, rng.uniform(0.01, 0.05, self.n_modes)
        signs = rng.choice([-1.0, 1.0], (n_outputs, self.n_modes))
        residues = signs * rng.uniform(0.3, 1.0, (n_outputs, self.n_modes)) * omegas**1.5
        names = tuple(f"y{j}" for j in range(n_outputs))
        size = 2 * self.n_modes + 2 + n_outputs * (self.n_modes + 2)
        zero, one = np.zeros(n_outputs), np.ones(n_outputs)
        self.model = ModalModel(
            "receptance",
            "force",
            names,
            omegas,
            zetas,
            residues,
            zero,
            zero,
            0.0,
            0.0,
            np.zeros((size, size)),
            one,
        )
        drive = InputSignal("force", "N", (0.0, self.period), rng.standard_normal(self.n), "zoh")
        times = self.period * np.arange(self.n)
        clean = self.model.simulate(drive, times)
        noise = np.std(clean, axis=0) / 10 ** (snr_db / 20) * rng.standard_normal(clean.shape)
        outputs = tuple(OutputSignal(name, "m", times, (clean + noise)[:, j]) for j, name in enumerate(names))
        whole = TimeRecord((drive,), outputs)
        half = 0.5 * self.period * self.n
        self.record, self.unseen = whole.between(0.0, half), whole.between(half, 2.0 * half)


def fit_behind_truth(case: ManyModes, model: ModalModel) -> float:
    """Return by how many per cent of FIT a model stays behind the true one on the unseen half, at worst."""
    scores = [
        np.array([output.scores.fit_percent for output in validate(own, case.unseen).outputs])
        for own in (case.model, model)
    ]
    return float(np.max(scores[0] - scores[1]))


class ManyModesCase:
    """The number of modes, and the prediction of the half that was not seen."""

    def __init__(self, snr_db: float, n_outputs: int) -> None:
        self.snr_db, self.n_outputs = snr_db, n_outputs

    def run(self, seed: int) -> Outcome:
        """Identify one structure without a hint."""
        case = ManyModes(seed, self.snr_db, self.n_outputs)
        start = time.perf_counter()
        model = identify(case.record, "receptance").model
        seconds = time.perf_counter() - start
        return Outcome(seconds, figures={"modes": model.n_modes, "behind": fit_behind_truth(case, model)})

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the share of records with all modes, and how far FIT stays behind that of the truth."""
        modes = np.array([o.figures["modes"] for o in outcomes])
        behind = np.array([o.figures["behind"] for o in outcomes])
        return {
            "right %": round(100.0 * float(np.mean(modes == ManyModes.n_modes)), 1),
            "too few, too many": [
                int(np.sum(modes < ManyModes.n_modes)),
                int(np.sum(modes > ManyModes.n_modes)),
            ],
            "FIT behind the truth's, mean and worst": [round(float(f(behind)), 2) for f in (np.mean, np.max)],
        }


STUDIES = {
    f"many-modes-{n_outputs}": Study(
        f"a dozen modes at {n_outputs} point{'s' * (n_outputs > 1)}, 15 dB",
        200,
        lambda n_outputs=n_outputs: ManyModesCase(15.0, n_outputs),
    )
    for n_outputs in (1, 2)
}
