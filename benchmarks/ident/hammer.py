"""A structure of three modes under a hammer: where the blow falls, how many there are, what the sensor shows.

The truth is SciPy's discretised plant at a fine tick; nothing of ``beam_ident`` is in it. The bound leaves free what
the estimate leaves free: gain, residual term, offset and ramp of every output, and the motion before the record,
except where it begins with the blow: there nothing tells the two apart, and the estimate takes the record from rest.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.signal import cont2discrete, lfilter

from beam_ident import (
    InputSignal,
    ModalStructure,
    OutputSignal,
    TimeRecord,
    analyse_modes,
    fit_frequency_modes,
    hammer_response,
    identify,
    stabilisation_chart,
)
from beam_ident.errors import EstimationError
from benchmarks.ident.study import AgainstBound, Outcome, Study

OMEGAS = 2.0 * np.pi * np.array([12.0, 47.0, 110.0])
ZETAS = np.array([0.01, 0.006, 0.008])
RESIDUES = np.array([[1.0, 0.5, 0.3], [0.4, -0.6, 0.5]])
NAMES = ("corner", "middle")
RATE_HZ = 1000.0
FINE = 32  # ticks of the truth for each sample of an output
FORCE = 4  # ticks for each sample of the force
NUMERATORS = {"receptance": [1.0], "mobility": [1.0, 0.0], "accelerance": [1.0, 0.0, 0.0]}
WIDTH_S = 3e-3
NOISE = 0.01  # of the output's rms over the first half second after a blow


def force(times_s: np.ndarray, blow_s: float, width_s: float = WIDTH_S) -> np.ndarray:
    """Return a blow that begins at an instant, as a squared sine [N]."""
    since = (times_s - blow_s) / width_s
    return np.where((since > 0.0) & (since < 1.0), 100.0 * np.sin(np.pi * since) ** 2, 0.0)


def _passed(
    numerator: list[float], omega: float, zeta: float, tick_s: float, signal: np.ndarray
) -> np.ndarray:
    b, a, _ = cont2discrete((numerator, [1.0, 2.0 * zeta * omega, omega**2]), tick_s, "foh")
    return np.asarray(lfilter(np.squeeze(b), a, signal))


class Blow:
    """One blow: force and what sensors of a kind show of it, shape (n_samples, 2)."""

    def __init__(self, kind: str, blow_s: float, duration_s: float) -> None:
        self.kind, self.blow_s = kind, blow_s
        self.tick_s = 1.0 / (RATE_HZ * FINE)
        self.ticks = self.tick_s * np.arange(round(duration_s * RATE_HZ) * FINE)
        self.fine = force(self.ticks, blow_s)
        self.times = self.ticks[::FINE]
        self.clean = self.outputs(OMEGAS, ZETAS)
        after = (self.times > blow_s) & (self.times < blow_s + 0.5)
        self.noise = NOISE * np.sqrt(np.mean(np.square(self.clean[after]), axis=0))

    def mode(self, omega: float, zeta: float) -> np.ndarray:
        """Return what a mode of residue one adds, at the samples."""
        return _passed(NUMERATORS[self.kind], omega, zeta, self.tick_s, self.fine)[::FINE]

    def outputs(self, omegas: np.ndarray, zetas: np.ndarray) -> np.ndarray:
        """Return both outputs without noise."""
        return np.stack([self.mode(w, z) for w, z in zip(omegas, zetas, strict=True)], axis=1) @ RESIDUES.T

    def record(self, rng: np.random.Generator) -> TimeRecord:
        """Return one noisy record."""
        seen = self.clean + self.noise * rng.standard_normal(self.clean.shape)
        drive = InputSignal("hammer", "N", (0.0, FORCE * self.tick_s), self.fine[::FORCE], "cubic")
        return TimeRecord(
            (drive,), tuple(OutputSignal(n, "", self.times, seen[:, j]) for j, n in enumerate(NAMES))
        )

    def information(self, is_free: bool) -> np.ndarray:
        """Return the information on frequencies and damping ratios, everything linear being unknown.

        Parameters
        ----------
        is_free : bool -- whether the motion before the record is unknown, too
        """
        columns = [np.ones(len(self.times)), self.times]
        second = np.gradient(np.gradient(self.fine, self.tick_s), self.tick_s)
        order = ("receptance", "mobility", "accelerance").index(self.kind)
        columns.append((self.fine, np.gradient(self.fine, self.tick_s), second)[order][::FINE])
        if order:
            columns.append((np.cumsum(self.fine) * self.tick_s, self.fine)[order - 1][::FINE])
        slopes = []
        for omega, zeta in zip(OMEGAS, ZETAS, strict=True):
            columns.append(self.mode(omega, zeta))
            dw, dz = 1e-5 * omega, 1e-6
            slopes.append((self.mode(omega + dw, zeta) - self.mode(omega - dw, zeta)) / (2.0 * dw))
            slopes.append((self.mode(omega, zeta + dz) - self.mode(omega, zeta - dz)) / (2.0 * dz))
            if is_free:
                pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
                ringing = np.exp(pole * self.times)
                columns += [ringing.real, ringing.imag]
        matrix = np.stack(columns, axis=1)
        # A blow has few samples, on which not all columns can differ.
        basis, sizes, _ = np.linalg.svd(matrix / np.linalg.norm(matrix, axis=0), full_matrices=False)
        basis = basis[:, sizes > 1e-8 * sizes[0]]
        result = np.zeros((6, 6))
        for row, sigma in zip(RESIDUES, self.noise, strict=True):
            own = np.stack([row[k // 2] * s for k, s in enumerate(slopes)], axis=1) / sigma
            own = own[:, [0, 2, 4, 1, 3, 5]]
            own -= basis @ (basis.T @ own)
            result += own.T @ own
        return result

    def scatter_under_window(self, rate: float) -> np.ndarray:
        """Return standard deviations of least squares on samples that an exponential weighs, from rest."""
        weight = np.exp(-rate * np.maximum(self.times - self.blow_s, 0.0))
        columns, slopes = [self.fine[::FINE]], []
        for omega, zeta in zip(OMEGAS, ZETAS, strict=True):
            columns.append(self.mode(omega, zeta))
            dw, dz = 1e-5 * omega, 1e-6
            slopes.append((self.mode(omega + dw, zeta) - self.mode(omega - dw, zeta)) / (2.0 * dw))
            slopes.append((self.mode(omega, zeta + dz) - self.mode(omega, zeta - dz)) / (2.0 * dz))
        matrix = np.stack(columns, axis=1)
        matrix = matrix / np.linalg.norm(matrix, axis=0)
        none = np.zeros_like(matrix)
        rows = []
        for j, (row, sigma) in enumerate(zip(RESIDUES, self.noise, strict=True)):
            own = np.stack([row[k // 2] * slopes[k] for k in (0, 2, 4, 1, 3, 5)], axis=1) / sigma
            rows.append(np.concatenate([own, *(matrix if k == j else none for k in range(2))], axis=1))
        design = np.concatenate(rows) * np.tile(weight, 2)[:, None]
        sizes = np.linalg.norm(design, axis=0)
        design = design / sizes
        solved = np.linalg.pinv(design, rcond=1e-10)
        # Noise under the window has its level: what scatters is the pseudo-inverse times the weights.
        return np.asarray(np.linalg.norm(solved * np.tile(weight, 2), axis=1)[:6] / sizes[:6])


class Hammer(AgainstBound):
    """Natural frequencies and damping ratios from samples, without a hint; another number of modes is a failure."""

    truth = np.concatenate([OMEGAS, ZETAS])

    def __init__(
        self, kind: str, blow_s: float, duration_s: float = 2.0, n_blows: int = 1, is_free: bool = True
    ) -> None:
        self.kind, self.n_blows = kind, n_blows
        self.blow = Blow(kind, blow_s, duration_s)
        information = n_blows * self.blow.information(is_free)
        unit = 1.0 / np.sqrt(np.diag(information))
        self.bound = np.sqrt(np.diag(np.linalg.inv(information * np.outer(unit, unit)))) * unit

    def records(self, seed: int) -> list[TimeRecord]:
        """Return the records of one seed, one for each blow."""
        rng = np.random.default_rng(seed)
        return [self.blow.record(rng) for _ in range(self.n_blows)]

    def run(self, seed: int) -> Outcome:
        """Identify the records of one seed."""
        records = self.records(seed)
        start = time.perf_counter()
        try:
            model = identify(records, self.kind).model  # type: ignore[arg-type]
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        seconds = time.perf_counter() - start
        return Outcome.of_modes(seconds, model, len(OMEGAS))


class WindowedHammer(Hammer):
    """The same through windowed, averaged responses: the mode search and modal analysis, side by side.

    The bound is the scatter of least squares on the samples under the same window: the lines are their transform.
    """

    truth = np.tile(Hammer.truth, 2)

    def __init__(self, n_blows: int, end_share: float | None = None, duration_s: float = 2.0) -> None:
        super().__init__("receptance", 0.02, duration_s, n_blows)
        self.end_share = end_share
        rate = hammer_response(self.records(0), end_share=end_share).decay_rate
        self.bound = np.tile(self.blow.scatter_under_window(rate) / np.sqrt(n_blows), 2)

    def run(self, seed: int) -> Outcome:
        """Fit the averaged response of one seed both ways."""
        records = self.records(seed)
        start = time.perf_counter()
        lines = hammer_response(records, end_share=self.end_share)
        searched = fit_frequency_modes(lines, ModalStructure("receptance")).model
        analysed = analyse_modes(stabilisation_chart(lines, "receptance", max_order=20))
        seconds = time.perf_counter() - start
        if not searched.n_modes == len(analysed.damping_ratios) == len(OMEGAS):
            return Outcome(seconds)
        both = (searched, analysed)
        return Outcome(
            seconds,
            np.concatenate([v for m in both for v in (m.natural_frequencies, m.damping_ratios)]),
            np.concatenate([v for m in both for v in (m.natural_frequency_sd, m.damping_ratio_sd)]),
        )


STUDIES = {
    "hammer-start": Study(
        "blow at 0.2 ms, displacement, still ringing at the end",
        200,
        lambda: Hammer("receptance", 2e-4, is_free=False),
    ),
    "hammer-accelerance": Study(
        "blow at 0.2 ms, acceleration", 200, lambda: Hammer("accelerance", 2e-4, is_free=False)
    ),
    "hammer-half": Study("blow at half the record, acceleration", 200, lambda: Hammer("accelerance", 1.0)),
    "hammer-rung-down": Study(
        "blow at 0.2 ms, acceleration, rung down at the end",
        200,
        lambda: Hammer("accelerance", 2e-4, 8.0, is_free=False),
    ),
    "hammer-ten": Study(
        "ten blows at 0.2 ms, acceleration", 200, lambda: Hammer("accelerance", 2e-4, 2.0, 10, is_free=False)
    ),
    "hammer-averaged": Study("five blows averaged, exponential window", 200, lambda: WindowedHammer(5)),
    "hammer-averaged-long": Study(
        "five blows averaged, rung down, exponential window", 200, lambda: WindowedHammer(5, duration_s=12.0)
    ),
}
