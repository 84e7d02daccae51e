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
TRUE_MODES = 14
USUAL_EVERY = 4  # runs: of the chirp and the multisine only the level is asked

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
    "coarse-encoder": {"hub.encoder_resolution": 1e-6},
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
        self.rig = Rig.from_file().with_values(changes)
        truth = theory_of_drive(self.rig.with_values({"beam.modes": TRUE_MODES}))
        self.structure = truth.structure
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
        self._clean: dict[Recipe, tuple[InputSignal, np.ndarray, np.ndarray, np.ndarray]] = {}
        known = identify(self.record(first, 10**6), self.structure).model
        self.design = design_for_rig(self.rig, "D", known, noise=NOISE_SD).design
        self.arms = {
            "optimal": self.design.optimal,
            "chirp": self.design.chirp,
            "multisine": self.design.multisine,
        }
        self.names = tuple(self.design.optimal.pole_sd)
        places = [
            int(np.argmin(np.abs(truth.natural_frequencies - w))) for w in self.predicted.natural_frequencies
        ]
        self.poles = np.concatenate([truth.natural_frequencies[places], truth.damping_ratios[places]])

    @property
    def predicted(self) -> ModalModel:
        """The model that the design started from."""
        return self.design.optimal.predicted

    def record(self, recipe: Recipe, seed: int) -> TimeRecord:
        """Return the encoder's or the force's and the camera's record of one seed."""
        rig, rng = self.rig, np.random.default_rng(seed)
        if recipe not in self._clean:
            self._clean[recipe] = self._simulated(recipe)
        drive, positions, stamps, clean = self._clean[recipe]
        if self.structure != "force":
            quantum = rig.hub.encoder_resolution
            zero = quantum * rng.uniform(-0.5, 0.5)
            positions = quantum * np.round((positions - zero) / quantum) + zero
            sigma = quantum / np.sqrt(12.0)
            drive = InputSignal("hub", "m", (0.0, rig.hub.period), positions, "cubic", sigma)
        seen = clean + NOISE_SD * rng.standard_normal(clean.shape)
        outputs = [
            OutputSignal(name, "m", stamps, seen[:, j], rig.camera.exposure)
            for j, name in enumerate(rig.markers.names)
        ]
        return TimeRecord((drive,), tuple(outputs))

    def _simulated(self, recipe: Recipe) -> tuple[InputSignal, np.ndarray, np.ndarray, np.ndarray]:
        """Return a recipe as drive, the hub's positions, the frames' stamps and what they show without noise."""
        period, camera = self.rig.hub.period, self.rig.camera
        excitation = recipe.sample(period)
        stamps = np.arange(1, int(excitation.duration_s * camera.rate) - 1) / camera.rate
        if self.structure == "force":
            drive = recipe.sample_input(period, self.mass, "N", "force").input_signal()
        else:
            drive = excitation.input_signal("acceleration")
        clean = self.truth.simulate(drive, stamps, camera.exposure)
        return drive, excitation.positions, stamps, clean

    def run(self, seed: int) -> Outcome:
        """Film and identify the designed excitation, at times the usual ones; a missing mode is a failure."""
        start = time.perf_counter()
        figures = {}
        for arm, own in self.arms.items():
            if arm != "optimal" and seed % USUAL_EVERY:
                continue
            model = identify(self.record(own.recipe, seed), self.structure).model
            if model.n_modes < self.predicted.n_modes:
                figures[f"modes after {arm}"] = float(model.n_modes)
                continue
            # Beside those that were known before, the experiment may show further ones.
            apart = np.abs(model.natural_frequencies[:, None] - self.predicted.natural_frequencies)
            places = np.argmin(apart, axis=0)
            found = np.concatenate([model.natural_frequencies[places], model.damping_ratios[places]])
            errors = found / self.poles - 1.0
            figures |= {f"{arm} {name}": float(e) for name, e in zip(self.names, errors, strict=True)}
            figures[f"further modes after {arm}"] = float(model.n_modes - self.predicted.n_modes)
        return Outcome(time.perf_counter() - start, figures=figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return scatter and bias of every excitation over its prediction, and the design's error over others'."""
        every = [own.figures for own in outcomes]
        missing = [
            {key: value for key, value in own.items() if key.startswith("modes after")} for own in every
        ]
        figures: dict[str, Any] = {"failures": sum(map(bool, missing))}
        if any(missing):
            figures["found"] = [own for own in missing if own][:3]
        errors = {
            arm: np.array(
                [
                    [own[f"{arm} {name}"] for name in self.names]
                    for own in every
                    if f"{arm} {self.names[0]}" in own
                ]
            )
            for arm in self.arms
        }
        if not all(len(own) > 1 for own in errors.values()):
            return figures
        for arm, own in self.arms.items():
            predicted = np.array([own.pole_sd[name] for name in self.names])
            further = [count for run in every if (count := run.get(f"further modes after {arm}")) is not None]
            figures |= {
                f"{arm}: runs": len(errors[arm]),
                f"{arm}: realised / predicted sd": self._named(
                    np.std(errors[arm], axis=0, ddof=1) / predicted
                ),
                f"{arm}: bias / predicted sd": self._named(np.mean(errors[arm], axis=0) / predicted),
                f"{arm}: further modes": round(float(np.mean(further)), 2),
            }
        rms = {arm: np.sqrt(np.mean(np.square(own), axis=0)) for arm, own in errors.items()}
        for arm in ("chirp", "multisine"):
            figures[f"error, optimal / {arm}"] = self._named(rms["optimal"] / rms[arm])
        worst = self.design.worst_parameter
        place = self.names.index(worst)
        return figures | {
            "worst known": worst,
            "predicted gain": round(self.design.worst_gain, 3),
            "realised gain": round(float(rms["optimal"][place] / rms["chirp"][place]), 3),
        }

    def _named(self, values: np.ndarray) -> dict[str, float]:
        """Return a figure of every pole by its name, in three decimals."""
        return dict(zip(self.names, np.round(values, 3).tolist(), strict=True))


STUDIES = {
    f"next-{name}": Study(
        f"designed excitation, {name} rig", 200, lambda changes=changes: NextExperimentCase(changes)
    )
    for name, changes in RIGS.items()
}
