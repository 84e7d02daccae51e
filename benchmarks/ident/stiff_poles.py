"""Poles a hundred and a thousand times faster than the others, seen at scattered stamps.

The input holds its levels; a stamp soon after a change of level shows the fast pole, all others the slow ones. The
truth is the exponential solution from level to level, with nothing of ``beam_ident`` in it.
"""

from __future__ import annotations

import time

import numpy as np

from beam_ident import InputSignal, OutputSignal, TimeRecord, estimate_transfer_function, identify
from beam_ident.errors import EstimationError
from benchmarks.ident.study import AgainstBound, Outcome, Study

OMEGA, ZETA = 2.0 * np.pi * 2.0, 0.05
FAST_ZETA = 0.02
NOISE = 0.05  # of the output's rms


class _Stiff(AgainstBound):
    """A record of levels held for ``tick_s``, and stamps scattered over it."""

    def __init__(self, ratio: float, tick_s: float, n_stamps: int, duration_s: float) -> None:
        rng = np.random.default_rng(1)
        self.fast = ratio * OMEGA
        self.tick_s = tick_s
        self.levels = rng.choice([-1.0, 1.0], round(duration_s / tick_s) + 1)
        # No stamp comes as the level changes, where rounding would decide which of them it sees.
        ticks = np.sort(rng.integers(0, len(self.levels) - 1, n_stamps)) + rng.uniform(0.001, 0.999, n_stamps)
        self.times = np.sort(ticks) * tick_s

    def passed(self, pole: complex) -> np.ndarray:
        """Return the response of 1/(s - pole) to the levels, from rest, at the stamps."""
        grown = np.exp(pole * self.tick_s)
        states = np.zeros(len(self.levels) + 1, dtype=complex)
        for k, level in enumerate(self.levels):
            states[k + 1] = grown * states[k] + (grown - 1.0) / pole * level
        place = np.floor(self.times / self.tick_s).astype(int)
        since = np.exp(pole * (self.times - place * self.tick_s))
        return np.asarray(since * states[place] + (since - 1.0) / pole * self.levels[place])

    def mode(self, omega: float, zeta: float) -> np.ndarray:
        """Return the responses of 1 and of s over s^2 + 2 zeta omega s + omega^2, shape (n_stamps, 2)."""
        pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
        answer = self.passed(pole)
        return np.stack([answer.imag, (pole * answer).imag], axis=1) / pole.imag

    def bound_of(self, slopes: list[np.ndarray], columns: np.ndarray) -> np.ndarray:
        """Return least standard deviations where the columns' factors are unknown, too."""
        basis, sizes, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
        basis = basis[:, sizes > 1e-9 * sizes[0]]
        design = np.stack(slopes, axis=1) / self.noise
        design -= basis @ (basis.T @ design)
        unit = 1.0 / np.linalg.norm(design, axis=0)
        return np.sqrt(np.diag(np.linalg.inv((design * unit).T @ (design * unit)))) * unit

    def record(self, seed: int) -> TimeRecord:
        """Return the noisy record of one seed."""
        seen = self.clean + self.noise * np.random.default_rng(seed).standard_normal(len(self.clean))
        drive = InputSignal("u", "N", self.tick_s * np.arange(len(self.levels)), self.levels, "zoh")
        return TimeRecord((drive,), (OutputSignal("y", "m", self.times, seen),))


class StiffTransferFunction(_Stiff):
    """Natural frequency, damping ratio and fast real pole of a transfer function with three poles and two zeros."""

    def __init__(self, ratio: float, tick_s: float, n_stamps: int) -> None:
        super().__init__(ratio, tick_s, n_stamps, 10.0)
        self.truth = np.array([OMEGA, ZETA, -self.fast])
        slow = self.mode(OMEGA, ZETA) @ np.array([OMEGA**2, 0.0])
        quick = self.fast * self.passed(-self.fast).real
        self.clean = slow + quick
        self.noise = NOISE * float(np.std(self.clean))
        dw, dz, dp = 1e-5 * OMEGA, 1e-6, 1e-5 * self.fast
        by_omega = (self.mode(OMEGA + dw, ZETA) - self.mode(OMEGA - dw, ZETA))[:, 0] * OMEGA**2 / (2.0 * dw)
        by_zeta = (self.mode(OMEGA, ZETA + dz) - self.mode(OMEGA, ZETA - dz))[:, 0] * OMEGA**2 / (2.0 * dz)
        by_pole = (self.passed(-self.fast + dp) - self.passed(-self.fast - dp)).real * self.fast / (2.0 * dp)
        columns = np.concatenate([self.mode(OMEGA, ZETA), quick[:, None]], axis=1)
        self.bound = self.bound_of([by_omega, by_zeta, by_pole], columns)

    def run(self, seed: int) -> Outcome:
        """Estimate the record of one seed with its numbers of poles and zeros given."""
        record = self.record(seed)
        start = time.perf_counter()
        try:
            found = estimate_transfer_function(record, 3, 2)
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        seconds = time.perf_counter() - start
        modes, (poles, pole_sd) = found.model.modes(), found.model.real_poles()
        if not found.converged or len(poles) != 1:
            return Outcome(seconds)
        estimate = np.array([modes[0][0], modes[1][0], poles[0]])
        return Outcome(seconds, estimate, np.array([modes[2][0], modes[3][0], pole_sd[0]]))


class StiffModes(_Stiff):
    """Natural frequencies and damping ratios of two modes, without a hint; another number of modes is a failure."""

    def __init__(self, ratio: float, tick_s: float, n_stamps: int) -> None:
        super().__init__(ratio, tick_s, n_stamps, 8.0)
        omegas, zetas = np.array([OMEGA, self.fast]), np.array([ZETA, FAST_ZETA])
        self.truth = np.concatenate([omegas, zetas])
        parts = [self.mode(w, z) for w, z in zip(omegas, zetas, strict=True)]
        sizes = [1.0 / float(np.std(part[:, 0])) for part in parts]
        self.clean = np.asarray(sum(size * part[:, 0] for size, part in zip(sizes, parts, strict=True)))
        self.noise = NOISE * float(np.std(self.clean))
        columns = [np.ones(n_stamps), self.times, self.levels[np.floor(self.times / tick_s).astype(int)]]
        by_omega, by_zeta = [], []
        for w, z, size in zip(omegas, zetas, sizes, strict=True):
            dw, dz = 1e-6 * w, 1e-6
            by_omega.append((self.mode(w + dw, z) - self.mode(w - dw, z))[:, 0] * size / (2.0 * dw))
            by_zeta.append((self.mode(w, z + dz) - self.mode(w, z - dz))[:, 0] * size / (2.0 * dz))
            ringing = np.exp(w * (-z + 1j * np.sqrt(1.0 - z**2)) * self.times)
            columns += [self.mode(w, z)[:, 0], ringing.real, ringing.imag]
        self.bound = self.bound_of([*by_omega, *by_zeta], np.stack(columns, axis=1))

    def run(self, seed: int) -> Outcome:
        """Identify the record of one seed."""
        record = self.record(seed)
        start = time.perf_counter()
        try:
            model = identify(record, "receptance").model
        except EstimationError:
            return Outcome(time.perf_counter() - start)
        seconds = time.perf_counter() - start
        return Outcome.of_modes(seconds, model, 2)


STUDIES = {
    "stiff-poles-100": Study(
        "a real pole 100 times faster than a mode", 200, lambda: StiffTransferFunction(100.0, 5e-3, 3000)
    ),
    "stiff-poles-1000": Study(
        "a real pole 1000 times faster than a mode", 200, lambda: StiffTransferFunction(1000.0, 5e-3, 3000)
    ),
    "stiff-modes-100": Study(
        "a mode 100 times faster than another", 200, lambda: StiffModes(100.0, 1e-3, 3000)
    ),
    "stiff-modes-1000": Study(
        "a mode 1000 times faster than another", 200, lambda: StiffModes(1000.0, 1e-4, 3000)
    ),
}
