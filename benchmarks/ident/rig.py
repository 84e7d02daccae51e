"""The default rig from its physics, filmed at a hundred frames a second."""

from __future__ import annotations

import dataclasses
import time
from functools import cached_property
from typing import Any

import numpy as np
from scipy.signal import lfilter

from beam_ident import EstimationError, InputSignal, LogChirp, ModalModel, OutputSignal, TimeRecord, identify
from beam_ident.sensing.commanded_motion import as_commanded
from beam_model import BeamModel, BeamParameters, Damping
from benchmarks.ident.study import AgainstBound, Outcome, Study, stated_bound

RATIOS = Damping(ratios=(0.005,))


class Rig:
    """The default rig from its physics: 14 modes, hub held at 1 kHz, three points, 100 frames a second."""

    heights = (0.010, 0.225, 0.285)
    names = ("z010", "z225", "z285")
    exposure = 5e-3

    def __init__(self, damping: Damping = RATIOS, chirp: LogChirp | None = None) -> None:
        self.parameters = BeamParameters.from_section(
            0.30,
            0.025,
            0.0005,
            7850.0,
            200e9,
            hub_mass=0.8,
            gravity="upright",
            damping=damping,
        )
        model = BeamModel(self.parameters, n_modes=14)
        heights = np.array(self.heights)
        residues = np.asarray(model.motion_residues(heights))
        size = 2 * 14 + 2 + 3 * 16
        self.full = ModalModel(
            "acceleration",
            "hub",
            self.names,
            model.natural_frequencies[:14],
            model.damping_ratios[:14],
            residues,
            np.asarray(model.residual_terms(heights)),
            np.ones(3),
            0.0,
            0.0,
            np.zeros((size, size)),
            np.ones(3),
        )
        self.excitation = (chirp or LogChirp()).sample()
        self.stamps = 0.01 * np.arange(1, round(100.0 * self.excitation.duration_s) - 1)
        self.clean = self.full.simulate(
            self.excitation.input_signal("acceleration"), self.stamps, self.exposure
        )
        self.truth = np.concatenate(
            [self.full.natural_frequencies[:3], model.damping_ratios[:3], residues[:, :3].ravel()]
        )

    def record(
        self,
        seed: int,
        *,
        quantum: float = 1e-7,
        encoder_sd: float = 0.0,
        colour: float = 0.0,
        shared: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> TimeRecord:
        """Return a record with camera noise of 5 um of an AR(1) colour, of which the outputs share some variance.

        The encoder counts quanta [m] from a zero of its own and adds noise [m].
        """
        rng = np.random.default_rng(seed)
        zero = quantum * rng.uniform(-0.5, 0.5)
        positions = quantum * np.round((self.excitation.positions - zero) / quantum) + zero
        positions = positions + encoder_sd * rng.standard_normal(len(positions))
        sigma = np.hypot(encoder_sd, quantum / np.sqrt(12.0))
        drive = InputSignal("hub", "m", (0.0, 1e-3), positions, "cubic", sigma)
        white = rng.standard_normal((self.clean.shape[0] + 200, 3))
        noise = np.sqrt(1.0 - colour**2) * lfilter([1.0], [1.0, -colour], white, axis=0)[200:]
        if any(shared):
            common = np.sqrt(1.0 - colour**2) * lfilter(
                [1.0], [1.0, -colour], rng.standard_normal(len(self.clean) + 200)
            )
            share = np.array(shared)
            noise = np.sqrt(1.0 - np.abs(share)) * noise + np.outer(
                common[200:], np.sign(share) * np.sqrt(np.abs(share))
            )
        values = self.clean + 5e-6 * noise
        outputs = [
            OutputSignal(n, "m", self.stamps, values[:, j], self.exposure) for j, n in enumerate(self.names)
        ]
        return TimeRecord((drive,), tuple(outputs))


def flat(model: ModalModel) -> tuple[np.ndarray, np.ndarray]:
    """Return a model's frequencies, damping ratios and residues, and their standard deviations."""
    parts = (model.natural_frequencies, model.damping_ratios, model.residues.ravel())
    sds = (model.natural_frequency_sd, model.damping_ratio_sd, model.residue_sd.ravel())
    return np.concatenate(parts), np.concatenate(sds)


class RigCase(AgainstBound):
    """Everything of three modes; the bound is that of the noise as it is, on input and outputs."""

    def __init__(self, encoder_sd: float = 0.0, **noise: Any) -> None:
        self.rig = Rig()
        self.noise: dict[str, Any] = {"encoder_sd": encoder_sd, **noise}
        self.truth = self.rig.truth

    @cached_property
    def bound(self) -> np.ndarray:
        """Return the standard deviations that records state."""
        return stated_bound(
            lambda seed: flat(identify(self.rig.record(seed, **self.noise), n_modes=3).model)[1]
        )

    def run(self, seed: int) -> Outcome:
        """Identify one record; another number of modes is a failure."""
        record = self.rig.record(seed, **self.noise)
        start = time.perf_counter()
        model = identify(record).model
        seconds = time.perf_counter() - start
        return Outcome(seconds, *flat(model)) if model.n_modes == 3 else Outcome(seconds)


class LedRigCase(RigCase):
    """The same with the commands beside the encoder, as bags of the rig have them; the bound knows the motion."""

    def __init__(self, encoder_sd: float) -> None:
        super().__init__(encoder_sd)

    @cached_property
    def bound(self) -> np.ndarray:
        """Return the standard deviations that records without an encoder's noise state."""
        return stated_bound(lambda seed: flat(identify(self.rig.record(seed), n_modes=3).model)[1])

    def run(self, seed: int) -> Outcome:
        """Identify one record; a motion that is not found to be the commanded one stays as measured."""
        record = self.rig.record(seed, **self.noise)
        start = time.perf_counter()
        led = as_commanded(record.inputs[0], self.rig.excitation.positions)
        model = identify(TimeRecord((led or record.inputs[0],), record.outputs)).model
        seconds = time.perf_counter() - start
        figures = {"led": float(led is not None)}
        if model.n_modes != 3:
            return Outcome(seconds, figures=figures)
        return Outcome(seconds, *flat(model), figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Add how often the motion was found to be the commanded one."""
        led = float(np.mean([own.figures["led"] for own in outcomes]))
        return super().summarise(outcomes) | {"led": round(led, 4)}


class NoisyEncoderCase(RigCase):
    """The same without the commands: two modes, which such an encoder still shows, and no others.

    The bound is what records state of themselves. A third mode that is a true one is no failure.
    """

    def __init__(self, encoder_sd: float, is_stated: bool) -> None:
        super().__init__(encoder_sd)
        self.is_stated = is_stated
        rig = self.rig.full
        self.truth = self._of_two(rig.natural_frequencies, rig.damping_ratios, np.asarray(rig.residues))

    @staticmethod
    def _of_two(frequencies: np.ndarray, ratios: np.ndarray, residues: np.ndarray) -> np.ndarray:
        return np.concatenate([frequencies[:2], ratios[:2], residues[:, :2].ravel()])

    @cached_property
    def bound(self) -> np.ndarray:
        """Return the standard deviations that records state."""
        return stated_bound(lambda seed: self._stated(seed)[1])

    def _stated(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        record = self.rig.record(seed, **self.noise)
        if not self.is_stated:
            (drive,) = record.inputs
            record = TimeRecord((dataclasses.replace(drive, sigma=0.0),), record.outputs)
        model = identify(record).model
        nearest = np.abs(
            np.log(np.divide.outer(model.natural_frequencies, self.rig.full.natural_frequencies))
        )
        if model.n_modes < 2 or np.any(np.argmin(nearest, axis=1) != np.arange(model.n_modes)):
            raise EstimationError(
                f"modes at {model.frequencies_hz} Hz; expected those of the rig, two at least"
            )
        return (
            self._of_two(model.natural_frequencies, model.damping_ratios, model.residues),
            self._of_two(model.natural_frequency_sd, model.damping_ratio_sd, model.residue_sd),
        )

    def run(self, seed: int) -> Outcome:
        """Identify one record; a mode that is missed or feigned is a failure."""
        start = time.perf_counter()
        try:
            found = self._stated(seed)
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        return Outcome(time.perf_counter() - start, *found)


STUDIES = {
    "rig": Study("rig, 0.1 um encoder, white camera noise", 400, RigCase),
    "rig-colour": Study("rig, camera noise AR(1) of 0.7", 400, lambda: RigCase(colour=0.7)),
    "rig-shared": Study(
        "rig, 97 % of the camera noise alike at all points", 200, lambda: RigCase(shared=(0.97, 0.97, 0.97))
    ),
    "rig-shared-colour": Study(
        "rig, camera noise AR(1) of 0.7, half of it shared with either sign",
        200,
        lambda: RigCase(colour=0.7, shared=(0.5, -0.5, 0.5)),
    ),
    "rig-encoder": Study("rig, 1 um of encoder noise", 400, lambda: RigCase(encoder_sd=1e-6)),
    "rig-encoder-bare": Study(
        "rig, 20 um of encoder noise, stated, no commands", 200, lambda: NoisyEncoderCase(20e-6, True)
    ),
    "rig-encoder-found": Study(
        "rig, 20 um of encoder noise that nobody stated", 200, lambda: NoisyEncoderCase(20e-6, False)
    ),
    "rig-encoder-20um": Study("rig, 20 um of encoder noise", 200, lambda: LedRigCase(encoder_sd=20e-6)),
}
