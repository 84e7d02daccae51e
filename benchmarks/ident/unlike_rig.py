"""Twenty simulated systems unlike the rig through the automatic call, beside what a peer can do.

Two to fourteen modes, rigid bodies, delays, drift, closed loops, and gaps in input and outputs; the first half
identifies, the second is predicted.  ``benchmarks.ident_unlike_rig`` sets peers beside it.  Others of the same kind
are all late by up to 60 ms.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beam_ident import (
    EstimationError,
    InputSignal,
    ModalModel,
    ModalStructure,
    OutputSignal,
    Prior,
    TimeRecord,
    identify,
    validate,
)
from benchmarks.ident.study import Outcome, Study

N_SYSTEMS = 20
N_LATE = 60
_LATEST_S = 0.06


@dataclass(frozen=True)
class UnlikeRig:
    """One system and its two halves.

    Attributes
    ----------
    title : str -- modes, outputs, and what is unusual
    structure : str -- what the input is
    truth : ModalModel
    first, second : TimeRecord -- with gaps as NaN: of both in the outputs, of the first in the input, too
    period : float -- of input and outputs [s]
    """

    title: str
    structure: ModalStructure
    truth: ModalModel
    first: TimeRecord
    second: TimeRecord
    period: float


def unlike_rig(seed: int, latest_s: float | None = None) -> UnlikeRig:
    """Return a system; its kind follows from the seed.

    Parameters
    ----------
    seed : int
    latest_s : float or None -- bound on a delay [s]; None delays every third system by up to 40 ms
    """
    rng = np.random.default_rng([seed, 20])
    n_modes = int(rng.integers(2, 15))
    n_outputs = int(rng.integers(1, 4))
    is_rigid = seed % 4 == 1
    delay = float(rng.uniform(0.0, 0.04)) if seed % 3 == 1 else 0.0
    if latest_s is not None:
        delay = float(np.random.default_rng([seed, 60]).uniform(0.0, latest_s))
    has_drift, is_loop = seed % 2 == 1, seed % 5 == 2 and not is_rigid
    gap = (0.0, 0.01, 0.05, 0.3)[seed // 2 % 4]
    middles = np.geomspace(0.6, 20.0, n_modes)
    ratio = middles[1] / middles[0]
    omegas = 2.0 * np.pi * np.sort(middles * ratio ** rng.uniform(-0.3, 0.3, n_modes))
    zetas = rng.uniform(0.005, 0.05, n_modes)
    residues = rng.choice([-1.0, 1.0], (n_outputs, n_modes)) * rng.uniform(0.3, 1.0, (n_outputs, n_modes))
    residues = residues * omegas**1.5
    gains = 0.3 * np.abs(residues[:, 0]) if is_rigid else np.zeros(n_outputs)
    kind = "force" if is_rigid else "receptance"
    names = tuple(f"y{j}" for j in range(n_outputs))
    size = 2 * n_modes + 2 + n_outputs * (n_modes + 2)
    zero, one = np.zeros(n_outputs), np.ones(n_outputs)
    truth = ModalModel(
        kind, "u", names, omegas, zetas, residues, zero, gains, delay, 0.0, np.zeros((size, size)), one
    )
    period, n = 0.01, 8000
    # Stamps are late, and show nothing from before the input.
    first = 5 if latest_s is None else round(latest_s / period) + 1
    times = period * np.arange(first, n)
    u = rng.standard_normal(n).repeat(2)[:n]
    if is_rigid:  # a force without a mean, so that a free body wanders and does not run away
        u = np.diff(u, prepend=0.0)
    drive = InputSignal("u", "N", (0.0, period), u, "zoh")
    clean = truth.simulate(drive, times - delay)
    noise = np.std(clean, axis=0) / 10.0 ** (rng.uniform(10.0, 30.0) / 20.0)
    values = clean + noise * rng.standard_normal(clean.shape)
    if is_loop:
        # A controller of the first output feeds back what was measured a sample before, noise included.
        k = 0.02 / max(float(np.max(np.abs(residues[0] / omegas**2))), 1e-300)
        for _ in range(30):
            fed = u - k * np.concatenate([np.zeros(first + 1), values[:-1, 0]])
            drive = InputSignal("u", "N", (0.0, period), fed, "zoh")
            following = truth.simulate(drive, times - delay) + (values - clean)
            moved = float(np.max(np.abs(following - values)))
            clean, values = following - (values - clean), following
            if moved < 1e-9 * float(np.max(np.abs(values))):
                break
    if has_drift:
        values = values + np.std(clean, axis=0) * (0.5 + 1.5 * times[:, None] / times[-1])
    if gap:
        # Half of the gaps in stretches, half alone.
        lost = rng.random(len(times)) < 0.5 * gap
        for start in rng.integers(0, n, max(1, round(0.5 * gap * n / 40))):
            lost[start : start + 40] = True
        values[lost] = np.nan
    outputs = tuple(OutputSignal(name, "m", times, values[:, j]) for j, name in enumerate(names))
    whole = TimeRecord((drive,), outputs)
    half = 0.5 * n * period
    first_half = whole.between(0.0, half)
    if gap:
        first_half = replace(first_half, inputs=(_holed(first_half.inputs[0], gap, seed),))
    said = [
        f"{n_modes} modes, {n_outputs} outputs",
        *["rigid body"] * is_rigid,
        *[f"{1e3 * delay:.0f} ms late"] * (delay > 0.0),
        *["drift"] * has_drift,
        *["closed loop"] * is_loop,
        *[f"{gap:.0%} lost"] * (gap > 0.0),
    ]
    return UnlikeRig(
        ", ".join(said),
        ModalStructure(kind),
        truth,
        first_half,
        whole.between(half, 2.0 * half),
        period,
    )


def _holed(drive: InputSignal, share: float, seed: int) -> InputSignal:
    """Return an input that lacks a share of its samples, in stretches of at most a twelfth of it."""
    rng = np.random.default_rng([seed, 21])
    n = len(drive.values)
    n_stretches = max(1, round(12.0 * share))
    length = round(share * n / n_stretches)
    kept = np.ones(n, dtype=bool)
    # One in each part of the record, so that together they are as long as they should be.
    for part in np.array_split(np.arange(1, n - 1), n_stretches):
        start = int(rng.integers(part[0], part[-1] - length))
        kept[start : start + length] = False
    return replace(drive, values=np.where(kept, drive.values, np.nan))


def unseen_fits(system: UnlikeRig, model: ModalModel) -> np.ndarray:
    """Return the FIT [%] of every output on the half that was not seen."""
    return np.array([output.scores.fit_percent for output in validate(model, system.second).outputs])


class UnlikeRigCase:
    """The automatic call on each of them, on the half that was not seen beside the true model."""

    def system(self, seed: int) -> UnlikeRig:
        """Return the system of a run."""
        return unlike_rig(seed)

    def run(self, seed: int) -> Outcome:
        """Identify one system without a hint but its structure; a refusal counts as a FIT of 0."""
        system = self.system(seed)
        of_truth = unseen_fits(system, system.truth)
        start = time.perf_counter()
        try:
            model = identify(system.first, system.structure, latency=Prior(0.0, np.inf)).model
        except EstimationError:
            return Outcome(
                time.perf_counter() - start, figures={"behind": float(np.max(of_truth)), "modes": -99.0}
            )
        seconds = time.perf_counter() - start
        figures = {
            "behind": float(np.max(of_truth - unseen_fits(system, model))),
            "modes": float(model.n_modes - system.truth.n_modes),
        }
        return Outcome(seconds, figures=figures)

    def summarise(self, outcomes: list[Outcome]) -> dict[str, Any]:
        """Return how far FIT stays behind the truth's, and how many modes are missing or too many."""
        behind = np.array([o.figures["behind"] for o in outcomes])
        modes = np.array([o.figures["modes"] for o in outcomes])
        return {
            "FIT behind the truth's, median and worst": [
                round(float(f(behind)), 2) for f in (np.median, np.max)
            ],
            "more than 1 % behind": int(np.sum(behind > 1.0)),
            "right order %": round(100.0 * float(np.mean(modes == 0)), 1),
            "too many": int(np.sum(modes > 0)),
        }


class LateSystems(UnlikeRigCase):
    """Others than the twenty, every one of them late."""

    def system(self, seed: int) -> UnlikeRig:
        """Return the system of a run."""
        return unlike_rig(N_SYSTEMS + seed, _LATEST_S)


STUDIES = {
    "unlike-rig": Study("systems unlike the rig, unseen half", N_SYSTEMS, UnlikeRigCase),
    "late-systems": Study("the same with delays of up to 60 ms", N_LATE, LateSystems),
}
