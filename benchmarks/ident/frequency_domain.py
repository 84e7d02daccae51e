"""Maximum likelihood on the lines of a multisine: a lightly damped two-output plant, and a filmed rig."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from beam_ident import (
    InputSignal,
    ModalModel,
    OutputSignal,
    TimeRecord,
    fit_frequency_modes,
    periodic_response,
)
from benchmarks.ident.study import AgainstBound, Outcome, Study

LINE_PERIOD_S = 10.0
N_PERIODS = 4


class Multisines(AgainstBound):
    """Four steady periods of a multisine; frequencies, damping ratios and residues without hints.

    The bound is that of all samples in time, the noise's level known, offset and drift unknown.
    """

    structure = "receptance"
    names: tuple[str, ...] = ("tip", "root")
    tick_s, step, lead, hold, exposure = 0.005, 1, 4, "zoh", 0.0
    lines_hz = np.arange(5, 500, 1) / 10.0
    ceiling_hz = np.inf

    def __init__(self, snr_db: float) -> None:
        model = self.plant()
        self.truth = np.concatenate([model.natural_frequencies, model.damping_ratios, model.residues.ravel()])
        n = round(LINE_PERIOD_S / self.tick_s)
        one = self.tick_s * np.arange(n)
        phases = np.random.default_rng(4).uniform(0.0, 2.0 * np.pi, len(self.lines_hz))
        sizes = 1.0 / (1.0 + (self.lines_hz / self.ceiling_hz) ** 2) / np.sqrt(len(self.lines_hz))
        period = sum(
            a * np.sin(2 * np.pi * f * one + p) for a, f, p in zip(sizes, self.lines_hz, phases, strict=True)
        )
        ticks = np.tile(period, self.lead + N_PERIODS + 1)
        self.drive = InputSignal("u", "", (0.0, self.tick_s), ticks, self.hold)
        self.stamps = self.tick_s * np.arange(self.lead * n, (self.lead + N_PERIODS) * n, self.step)
        self.clean = model.simulate(self.drive, self.stamps, self.exposure)
        power = np.mean((self.clean - np.mean(self.clean, axis=0)) ** 2, axis=0)
        self.noise = np.sqrt(power) * 10.0 ** (-snr_db / 20.0)
        self.bound = self._bound(model)

    def plant(self) -> ModalModel:
        """Return the reference page's beam: 2.3, 14.4 and 40 Hz, 2, 1 and 0.5 % of damping."""
        omegas = 2.0 * np.pi * np.array([2.3, 14.4, 40.0])
        residues = np.array([[1.0, -0.25, 0.08], [0.05, 0.08, -0.06]]) * omegas**2
        return ModalModel(
            "receptance",
            "u",
            self.names,
            omegas,
            np.array([0.02, 0.01, 0.005]),
            residues,
            np.zeros(2),
            np.zeros(2),
            0.0,
            0.0,
            np.zeros((18, 18)),
            np.ones(2),
        )

    def record(self, seed: int) -> TimeRecord:
        """Return the steady periods with white noise."""
        noisy = self.clean + self.noise * np.random.default_rng(seed).standard_normal(self.clean.shape)
        outputs = [
            OutputSignal(name, "", self.stamps, noisy[:, j], self.exposure)
            for j, name in enumerate(self.names)
        ]
        return TimeRecord((self.drive,), tuple(outputs))

    def _bound(self, model: ModalModel) -> np.ndarray:
        """Return the Cramer-Rao bound of all samples in time, by differences of the simulation."""
        parameters = np.concatenate([self.truth, model.residual_terms, model.gains])
        is_free = np.ones(len(parameters), dtype=bool)
        is_free[len(parameters) - len(self.names) :] = self.structure != "receptance"
        columns = []
        for k in np.flatnonzero(is_free):
            step = 1e-5 * max(abs(parameters[k]), 1e-6)
            ends = []
            for sign in (1.0, -1.0):
                moved = parameters.copy()
                moved[k] += sign * step
                ends.append(self._with(model, moved).simulate(self.drive, self.stamps, self.exposure))
            columns.append((ends[0] - ends[1]) / (2.0 * step) / self.noise)
        n, m = self.clean.shape
        for j in range(m):
            for shape in (np.ones(n), np.linspace(-1.0, 1.0, n)):
                column = np.zeros((n, m))
                column[:, j] = shape
                columns.append(column)
        design = np.stack([column.ravel() for column in columns], axis=1)
        scale = np.linalg.norm(design, axis=0)
        information = (design / scale).T @ (design / scale)
        return np.sqrt(np.diag(np.linalg.inv(information)))[: len(self.truth)] / scale[: len(self.truth)]

    def _with(self, model: ModalModel, parameters: np.ndarray) -> ModalModel:
        n, m = model.n_modes, len(self.names)
        parts = np.split(parameters, [n, 2 * n, 2 * n + n * m, 2 * n + n * m + m])
        return dataclasses.replace(
            model,
            natural_frequencies=parts[0],
            damping_ratios=parts[1],
            residues=parts[2].reshape(m, n),
            residual_terms=parts[3],
            gains=parts[4],
        )

    def run(self, seed: int) -> Outcome:
        """Identify one record, spectra included; another number of modes is a failure."""
        record = self.record(seed)
        start = time.perf_counter()
        found = periodic_response(record, LINE_PERIOD_S, self.lines_hz)
        model = fit_frequency_modes(found.response, self.structure).model
        seconds = time.perf_counter() - start
        estimate, sd = flat(model)
        return Outcome(seconds, estimate, sd) if len(estimate) == len(self.truth) else Outcome(seconds)


class FilmedRig(Multisines):
    """Base motion in at 1 kHz, two points out at 50 frames a second with 5 ms of exposure.

    Lines up to 47.2 Hz fold at 25 Hz; the second mode at 38.7 Hz is above half the frame rate.
    """

    structure = "base_motion"
    tick_s, hold, exposure = 1e-3, "cubic", 5e-3
    lead, step = 12, 20
    lines_hz = np.arange(10, 475, 3) / 10.0
    ceiling_hz = 2.0

    def plant(self) -> ModalModel:
        """Return two modes on a moved base, with residual terms."""
        return ModalModel(
            "base_motion",
            "u",
            self.names,
            2.0 * np.pi * np.array([4.4, 38.7]),
            np.array([0.01, 0.006]),
            np.array([[1.5, -0.75], [0.3, 0.35]]),
            np.array([1e-6, -1e-6]),
            np.ones(2),
            0.0,
            0.0,
            np.zeros((14, 14)),
            np.ones(2),
        )


def flat(model: ModalModel) -> tuple[np.ndarray, np.ndarray]:
    """Return a model's frequencies, damping ratios and residues, and their standard deviations."""
    parts = (model.natural_frequencies, model.damping_ratios, model.residues.ravel())
    sds = (model.natural_frequency_sd, model.damping_ratio_sd, model.residue_sd.ravel())
    return np.concatenate(parts), np.concatenate(sds)


STUDIES = {
    "frequency-domain": Study("multisine, three modes, two outputs, 20 dB", 1000, lambda: Multisines(20.0)),
    "frequency-domain-0": Study("multisine, three modes, two outputs, 0 dB", 1000, lambda: Multisines(0.0)),
    "frequency-domain-folded": Study(
        "multisine on a moved base, a mode above half the frame rate, 40 dB", 400, lambda: FilmedRig(40.0)
    ),
}
