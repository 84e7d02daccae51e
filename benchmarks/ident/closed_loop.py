"""A resonant stage under a sampled PI controller: bias and intervals of the closed-loop estimator."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter, max_len_seq

from beam_ident import (
    InputSignal,
    OutputSignal,
    SampledController,
    TimeRecord,
    estimate_in_closed_loop,
    estimate_transfer_function,
)
from benchmarks.ident.study import Outcome, Study

PERIOD_S = 0.02
POLES = np.array([-0.6 + 10.0j, -0.6 - 10.0j, -2.0])
PARAMETERS = np.concatenate([np.real(np.poly(POLES))[1:], [40.0, 250.0]])  # a1 a2 a3, b0 b1
GAIN, INTEGRAL_GAIN = 0.3, 1.0
CONTROLLER = SampledController(
    np.array([GAIN + INTEGRAL_GAIN * PERIOD_S, -GAIN]), np.array([1.0, -1.0]), PERIOD_S
)


def loop_record(seed: int, colour: float, snr_db: float, n_samples: int = 3000) -> TimeRecord:
    """Return reference, input and output of the loop, with AR(1) noise on what the controller sees.

    Simulated apart from the library: transfer functions of the whole loop in z^-1.
    """
    above, below, _ = cont2discrete(
        (PARAMETERS[3:], np.concatenate([[1.0], PARAMETERS[:3]])), PERIOD_S, "zoh"
    )
    plant, common = above[0], below
    loop = np.convolve(common, CONTROLLER.denominator) + np.convolve(plant, CONTROLLER.numerator)
    reference = np.resize(np.repeat(2.0 * max_len_seq(10)[0] - 1.0, 8), n_samples)
    white = np.random.default_rng(seed).standard_normal(n_samples + 200)
    noise = lfilter([np.sqrt(1.0 - colour**2)], [1.0, -colour], white)[200:]
    clean = lfilter(np.convolve(plant, CONTROLLER.numerator), loop, reference)
    noise *= np.std(clean) / 10 ** (snr_db / 20)
    output = clean + lfilter(np.convolve(common, CONTROLLER.denominator), loop, noise)
    drive = lfilter(np.convolve(common, CONTROLLER.numerator), loop, reference - noise)
    return TimeRecord(
        (
            InputSignal("reference", "", (0.0, PERIOD_S), reference),
            InputSignal("drive", "", (0.0, PERIOD_S), drive),
        ),
        (OutputSignal("position", "", (0.0, PERIOD_S), output),),
    )


class LoopCase:
    """The five coefficients, from inside the loop by instruments of the reference, and as if there were no loop."""

    def __init__(self, colour: float, snr_db: float) -> None:
        self.colour, self.snr_db = colour, snr_db

    def run(self, seed: int) -> Outcome:
        """Estimate one record both ways; the open-loop estimate goes along as figures."""
        record = loop_record(seed, self.colour, self.snr_db)
        start = time.perf_counter()
        found = estimate_in_closed_loop(record, CONTROLLER, 3, 1, "reference", "drive")
        seconds = time.perf_counter() - start
        if not found.converged:
            return Outcome(seconds)
        open_loop = TimeRecord((record.input("drive"),), record.outputs)
        plain = estimate_transfer_function(open_loop, 3, 1, method="white")
        figures = {
            f"open {name}": float(value)
            for name, value in zip(found.model.parameter_names[:5], plain.model.parameters[:5], strict=True)
        }
        return Outcome(seconds, found.model.parameters[:5], found.model.standard_deviations[:5], figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return the bias of both in units of their scatter, and how true the stated deviations are."""
        good = [o for o in outcomes if o.estimate is not None and o.sd is not None]
        figures: dict[str, Any] = {"failures": len(outcomes) - len(good)}
        if not good:
            return figures
        errors = np.array([o.estimate - PARAMETERS for o in good])
        scores = errors / np.array([o.sd for o in good])
        plain = np.array([list(o.figures.values()) for o in good]) - PARAMETERS
        return figures | {
            "bias / sd": _rounded(errors.mean(axis=0) / errors.std(axis=0)),
            "open-loop SRIVC bias / sd": _rounded(plain.mean(axis=0) / plain.std(axis=0)),
            "stated / true sd": _rounded(np.median([o.sd for o in good], axis=0) / errors.std(axis=0)),
            "coverage": round(float(np.mean(np.abs(scores) < 1.96)), 4),
            "worst coverage": round(float(np.min(np.mean(np.abs(scores) < 1.96, axis=0))), 4),
            "max |z|": round(float(np.max(np.abs(scores))), 2),
        }


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(v), 2) for v in values]


STUDIES = {
    "closed-loop-white": Study("closed loop, white noise 10 dB", 400, lambda: LoopCase(0.0, 10.0)),
    "closed-loop-colour": Study("closed loop, noise AR(1) of 0.9, 10 dB", 400, lambda: LoopCase(0.9, 10.0)),
}
