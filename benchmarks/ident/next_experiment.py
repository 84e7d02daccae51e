"""Designed excitations against the best chirp and multisine of their length, on rigs from their physics.

A first, short chirp of low level is identified; from its model the next experiment is designed, for the rig's limits,
camera and markers. Then every excitation is filmed with fresh noise and identified without hints: do the estimates
scatter as the design predicts, and how much less than after the best chirp?
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from beam_ident import InputSignal, LogChirp, ModalModel, OutputSignal, Recipe, TimeRecord, identify
from beam_ros.excitation.optimal import design_for_rig, theory_of_drive
from beam_ros.rig.rig import Rig
from benchmarks.ident.study import Outcome, Study

NOISE_SD = 5e-6
FIRST_SHARE = 0.02  # of the largest acceleration

RIGS: dict[str, dict[str, Any]] = {
    "default": {},
    "force": {"hub.command_mode": "effort", "excitation.end_frequency": 45.0},
    "wide": {
        "hub.travel": 0.4,
        "hub.max_speed": 2.0,
        "hub.max_acceleration": 40.0,
        "hub.max_effort": 200.0,
        "beam.max_root_strain": 0.002,
        "excitation.duration": 8.0,
        "excitation.still": 4.0,
    },
    "slow-camera": {"camera.rate": 30.0, "camera.exposure": 0.002, "excitation.end_frequency": 45.0},
    "tiny-travel": {
        "hub.travel": 0.002,
        "excitation.max_displacement": 0.001,
        "excitation.end_frequency": 45.0,
    },
    "soft-strip": {
        "beam.length": 1.0,
        "beam.thickness": 0.001,
        "beam.gravity": "hanging",
        "markers.heights": [0.01, 0.7, 0.95],
        "hub.max_tip_deflection": 0.1,
        "camera.height": 1600,
        "camera.origin_v": 1585.0,
        "excitation.start_frequency": 0.3,
        "excitation.end_frequency": 22.0,
        "excitation.duration": 40.0,
        "excitation.still": 10.0,
    },
}


class NextExperimentCase:
    """One rig: its truth of fourteen modes, and what was designed from a first record.

    Parameters
    ----------
    changes : dict -- of the packaged rig
    """

    def __init__(self, changes: dict[str, Any]) -> None:
        self.rig = Rig.from_file().with_values({**changes, "beam.modes": 14})
        truth = theory_of_drive(self.rig)
        self.truth = truth if truth.structure == "force" else truth.driven_by("acceleration")
        self.mass = self.rig.beam_parameters().total_mass
        excitation = self.rig.excitation
        first = LogChirp(
            excitation.start_frequency,
            excitation.end_frequency,
            excitation.duration,
            FIRST_SHARE * self.rig.hub.max_acceleration,
            0.2 * self.rig.hub.travel,
            excitation.still,
        )
        known = identify(self.record(first, 10**6), truth.structure).model
        self.design = design_for_rig(self.rig, "D", known, noise=NOISE_SD).design
        self.arms = {
            "optimal": self.design.optimal,
            "chirp": self.design.chirp,
            "multisine": self.design.multisine,
        }
        self.names = tuple(self.design.optimal.pole_sd)
        n = len(self.names) // 2
        places = [
            int(np.argmin(np.abs(truth.natural_frequencies - w))) for w in self.predicted.natural_frequencies
        ]
        self.poles = np.concatenate([truth.natural_frequencies[places], truth.damping_ratios[places]])
        self.n_modes = n
        self._clean: dict[int, tuple[InputSignal, np.ndarray]] = {}

    @property
    def predicted(self) -> ModalModel:
        """The model that the design started from."""
        return self.design.optimal.predicted

    def record(self, recipe: Recipe, seed: int) -> TimeRecord:
        """Return the encoder's or the force's and the camera's record of one seed."""
        rng = np.random.default_rng(seed)
        rig, period = self.rig, self.rig.hub.period
        excitation = recipe.sample(period)
        rate, exposure = rig.camera.rate, rig.camera.exposure
        stamps = np.arange(1, int(excitation.duration_s * rate) - 1) / rate
        if self.truth.structure == "force":
            drive = recipe.sample_input(period, self.mass, "N", "force").input_signal()
            clean = self.truth.simulate(drive, stamps, exposure)
        else:
            clean = self.truth.simulate(excitation.input_signal("acceleration"), stamps, exposure)
            quantum = rig.hub.encoder_resolution
            zero = quantum * rng.uniform(-0.5, 0.5)
            positions = quantum * np.round((excitation.positions - zero) / quantum) + zero
            drive = InputSignal("hub", "m", (0.0, period), positions, "cubic", quantum / np.sqrt(12.0))
        seen = clean + NOISE_SD * rng.standard_normal(clean.shape)
        outputs = [
            OutputSignal(name, "m", stamps, seen[:, j], exposure) for j, name in enumerate(rig.markers.names)
        ]
        return TimeRecord((drive,), tuple(outputs))

    def run(self, seed: int) -> Outcome:
        """Film and identify every excitation; another number of modes in any is a failure."""
        start = time.perf_counter()
        figures = {}
        for arm, own in self.arms.items():
            model = identify(self.record(own.recipe, seed), theory_of_drive(self.rig).structure).model
            if model.n_modes != self.n_modes:
                return Outcome(
                    time.perf_counter() - start, figures={f"modes after {arm}": float(model.n_modes)}
                )
            errors = np.concatenate([model.natural_frequencies, model.damping_ratios]) / self.poles - 1.0
            figures |= {f"{arm} {name}": float(e) for name, e in zip(self.names, errors, strict=True)}
        return Outcome(time.perf_counter() - start, figures=figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return scatter over prediction of every excitation, and the designed one's over the chirp's."""
        good = [o.figures for o in outcomes if len(o.figures) == len(self.arms) * len(self.names)]
        figures: dict[str, Any] = {"failures": len(outcomes) - len(good)}
        failed = [o.figures for o in outcomes if len(o.figures) != len(self.arms) * len(self.names)]
        if failed:
            figures["found"] = failed[:3]
        if not good:
            return figures
        rms = {
            (arm, name): float(np.sqrt(np.mean([f[f"{arm} {name}"] ** 2 for f in good])))
            for arm in self.arms
            for name in self.names
        }
        for arm, own in self.arms.items():
            figures[f"{arm}: realised / predicted"] = {
                name: round(rms[arm, name] / own.pole_sd[name], 3) for name in self.names
            }
        worst = self.design.worst_parameter
        for arm in ("chirp", "multisine"):
            figures[f"optimal / {arm}"] = {
                name: round(rms["optimal", name] / rms[arm, name], 3) for name in self.names
            }
        return figures | {
            "worst known": worst,
            "predicted gain": round(self.design.worst_gain, 3),
            "realised gain": round(rms["optimal", worst] / rms["chirp", worst], 3),
        }


STUDIES = {
    f"next-{name}": Study(
        f"designed excitation, {name} rig", 200, lambda changes=changes: NextExperimentCase(changes)
    )
    for name, changes in RIGS.items()
}
