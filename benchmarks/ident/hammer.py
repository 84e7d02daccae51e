"""A structure of three modes under a hammer: where the blow falls, how many there are, what the sensor shows.

The truth is SciPy's discretised plant at a fine tick; nothing of ``beam_ident`` is in it. The bound leaves free what
the estimate leaves free: gain, residual term, offset and ramp of every output, and the motion before the record,
except where it begins with the blow: there nothing tells the two apart, and the estimate takes the record from rest.
"""

from __future__ import annotations

import time

import numpy as np
from scipy.signal import cont2discrete, lfilter

from beam_ident import InputSignal, OutputSignal, TimeRecord, identify
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
        if model.n_modes != len(OMEGAS):
            return Outcome(seconds)
        return Outcome(
            seconds,
            np.concatenate([model.natural_frequencies, model.damping_ratios]),
            np.concatenate([model.natural_frequency_sd, model.damping_ratio_sd]),
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
}
