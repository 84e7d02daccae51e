"""Experimental modal analysis of a chain of five masses, with 1 % of noise.

Beside a peer, in an environment that has it (``pip install sdypy-EMA``), on the same responses:

    python -m benchmarks.ident.modal_analysis [--runs N]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from beam_ident import FrequencyRecord, analyse_modes, stabilisation_chart
from benchmarks.ident.study import AgainstBound, Outcome, Study
from tests.beam_ident.modal_analysis import chain

MAX_ORDER = 30


class Chain(AgainstBound):
    """Frequencies and damping ratios, the number of modes included; another number is a failure.

    The bound knows the noise and leaves every residue and residual term free.
    """

    def __init__(self, inputs: tuple[int, ...], is_relative: bool, noise: float = 0.01) -> None:
        self.inputs, self.is_relative, self.noise = inputs, is_relative, noise
        self.truth = np.concatenate([chain.OMEGAS, chain.DAMPING])
        self.bound = self._bound()

    def record(self, seed: int) -> FrequencyRecord:
        """Return noisy receptances; variances go with noise that differs from line to line."""
        return chain.noisy_record(
            seed, self.noise, self.inputs, is_relative=self.is_relative, has_variance=self.is_relative
        )

    def _bound(self) -> np.ndarray:
        clean = chain.response(chain.LINES, self.inputs)
        rms = np.sqrt(np.mean(np.abs(clean) ** 2, axis=0)) * np.ones(clean.shape)
        sd = self.noise * (np.abs(clean) if self.is_relative else rms)
        s = 1j * chain.LINES
        information = np.zeros((10, 10))
        for j in range(clean.shape[1]):
            for i, drive in enumerate(self.inputs):
                strength = chain.SHAPES[j] * chain.SHAPES[drive]
                columns, poles = [np.ones(len(s), dtype=complex), 1.0 / s**2], []
                for omega, zeta, factor in zip(chain.OMEGAS, chain.DAMPING, strength, strict=True):
                    d = s**2 + 2.0 * zeta * omega * s + omega**2
                    columns += [1.0 / d, s / d]
                    poles.append(
                        [-factor * (2.0 * zeta * s + 2.0 * omega) / d**2, -factor * 2.0 * omega * s / d**2]
                    )
                every = [p[0] for p in poles] + [p[1] for p in poles] + columns
                stacked = np.stack(every, axis=1) * (np.sqrt(2.0) / sd[:, j, i])[:, None]
                design = np.concatenate([stacked.real, stacked.imag])
                scale = np.linalg.norm(design, axis=0)
                basis = np.linalg.qr(design[:, 10:] / scale[10:])[0]
                free = design[:, :10] - basis @ (basis.T @ design[:, :10])
                information += free.T @ free
        unit = 1.0 / np.sqrt(np.diag(information))
        return np.sqrt(np.diag(np.linalg.inv(information * np.outer(unit, unit)))) * unit

    def run(self, seed: int) -> Outcome:
        """Analyse one record without hints."""
        record = self.record(seed)
        start = time.perf_counter()
        found = analyse_modes(stabilisation_chart(record, max_order=MAX_ORDER))
        seconds = time.perf_counter() - start
        if len(found.damping_ratios) != 5:
            return Outcome(seconds)
        estimate = np.concatenate([found.natural_frequencies, found.damping_ratios])
        sd = np.concatenate([found.natural_frequency_sd, found.damping_ratio_sd])
        return Outcome(seconds, estimate, sd)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Add the largest relative error of damping to the figures against the bound."""
        figures = super().summarise(outcomes)
        errors = [
            np.max(np.abs(o.estimate[5:] / chain.DAMPING - 1.0)) for o in outcomes if o.estimate is not None
        ]
        return figures | {"worst damping error %": round(100.0 * float(np.max(errors, initial=0.0)), 3)}


class Peer(Chain):
    """sdypy-EMA's least-squares complex frequency estimate at the poles nearest to the true frequencies."""

    def run(self, seed: int) -> Outcome:
        """Analyse one record, the frequencies given as hints."""
        from sdypy import EMA  # type: ignore[import-not-found]

        record = self.record(seed)
        start = time.perf_counter()
        model = EMA.Model(
            frf=record.response[:, :, 0].T,
            freq=record.frequencies_hz,
            lower=record.frequencies_hz[0],
            upper=record.frequencies_hz[-1],
            pol_order_high=60,
            frf_form="receptance",
        )
        model.get_poles(method="lscf", show_progress=False)
        model.select_closest_poles(list(chain.FREQUENCIES_HZ))
        seconds = time.perf_counter() - start
        estimate = np.concatenate([2.0 * np.pi * np.asarray(model.nat_freq), np.asarray(model.nat_xi)])
        return Outcome(seconds, estimate, np.full(10, np.inf))


def compared(make: Callable[..., Chain], runs: int, noise: float) -> dict[str, Any]:
    """Return root-mean-square errors in units of the bound, relative ones, and the median time."""
    case = make((0,), True, noise)
    done = [case.run(seed) for seed in range(runs)]
    good = np.array([o.estimate for o in done if o.estimate is not None])
    errors = good - case.truth
    return {
        "failures": runs - len(good),
        "rms error / bound": [round(float(e), 2) for e in np.sqrt(np.mean(errors**2, axis=0)) / case.bound],
        "worst damping error %": f"{100.0 * np.max(np.abs(errors[:, 5:] / chain.DAMPING)):.3g}",
        "median s": round(float(np.median([o.seconds for o in done])), 3),
    }


def main() -> int:
    """Print both on the same records, nearly without noise and with 1 %."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.ident.modal_analysis")
    parser.add_argument("--runs", type=int, default=20)
    runs = parser.parse_args().runs
    for noise in (1e-9, 0.01):
        for name, make in (("beam_ident", Chain), ("sdypy-EMA", Peer)):
            print(f"noise {noise:g}, {name}: {compared(make, runs, noise)}", flush=True)
    return 0


STUDIES = {
    "modal-analysis": Study(
        "five masses, one input, noise of 1 % of every value", 400, lambda: Chain((0,), True)
    ),
    "modal-analysis-level": Study(
        "five masses, two inputs, noise of 1 % of the rms, its level unknown",
        400,
        lambda: Chain((0, 2), False),
    ),
}

if __name__ == "__main__":
    raise SystemExit(main())
