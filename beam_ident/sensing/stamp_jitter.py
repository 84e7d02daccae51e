"""Stamps that scatter: noise that grows with the speed of what is measured, and is common to all outputs.

A stamp that is late by delta shifts what all outputs show at that instant by ``-speed delta``. Such noise is largest
where the outputs move fastest, which is where they tell most of clock and damping, and no marker averages it away:
taken for noise of one level that is independent from output to output, it makes intervals of the clock and the first
frequencies too narrow, and those of what the quiet parts show too wide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc as chi_squared_sf

from beam_ident.arrays import BoolArray, FloatArray, IndexArray
from beam_ident.noise.scores import Whiteness
from beam_ident.noise.shared_noise import SharedNoise, regular_correlation

_LEVEL = 1e-6  # how often stamps without an error are said to scatter
_COLOURED = 1e-6  # what an error of the model leaves follows the speed too, but not at random
_WILD = 6.0  # standard deviations: outliers are no jitter
_TURNS = 200
_SETTLED = 1e-6


@dataclass(frozen=True, eq=False)
class StampJitter:
    """Scatter of the stamps of one record, which its outputs share.

    Attributes
    ----------
    sd_s : float -- standard deviation [s]; 0: none is seen
    variances : ndarray, shape (n_outputs,) -- of the outputs' own noise beside it
    speeds : ndarray, shape (n_instants, n_outputs) -- of the outputs, 0 where none was seen [unit/s]
    """

    sd_s: float
    variances: FloatArray
    speeds: FloatArray

    @staticmethod
    def of(residuals: FloatArray, speeds: FloatArray, seen: BoolArray) -> StampJitter:
        """Estimate it from what a fit with equal weights left.

        Parameters
        ----------
        residuals, speeds : ndarray, shape (n_instants, n_outputs)
            Of instants at which outputs have one stamp in common; zero where an output was not seen.
        seen : ndarray of bool, shape (n_instants, n_outputs)

        Notes
        -----
        The residuals of an instant have the covariance ``C + tau v v^T``, v the speeds, and C that of the outputs'
        own noise, diagonal where they share none. Likelihood is climbed in turns: ``tau`` by scoring, C by
        expectation over the errors of the stamps. With ``s = v^T C^-1 r`` and ``q = v^T C^-1 v`` an error is
        ``tau s / (1 + tau q)`` on average.
        """
        instants = _Instants.of(residuals, speeds, seen)
        plain = instants.covariance(residuals, np.zeros(len(residuals)))
        none = StampJitter(0.0, np.diag(plain).copy(), speeds)
        covariance = plain
        # To begin with, half of what is left is the jitter's.
        alone = np.maximum(np.diag(plain), 1e-300)
        tau = 0.5 * float(np.sum(residuals**2 / alone)) / max(float(np.sum(speeds**2 / alone)), 1e-300)
        for _ in range(_TURNS):
            s, q, _, _ = instants.products(covariance)
            spread = 1.0 / (1.0 + tau * q)
            step = np.sum((s**2 - q - tau * q**2) * spread**2) / max(np.sum((q * spread) ** 2), 1e-300)
            before, tau = tau, max(tau + float(step), 0.0)
            if tau == 0.0:
                return none
            spread = 1.0 / (1.0 + tau * q)
            moved = instants.covariance(residuals - speeds * (tau * s * spread)[:, None], tau * spread)
            change = max(
                abs(tau / before - 1.0), float(np.max(np.abs(moved - covariance)) / np.max(np.diag(moved)))
            )
            covariance = moved
            if change < _SETTLED:
                break
        s, q, power, size = instants.products(covariance)
        grown = 1.0 + tau * q
        # Twice the gain in log-likelihood over noise of one level.
        _, _, power_before, size_before = instants.products(plain)
        gain = size_before + power_before - size - power - float(np.sum(np.log(grown)))
        gain += float(np.sum(tau * s**2 / grown))
        errors = s[q > 0.0] / np.sqrt((q * grown)[q > 0.0])
        if chi_squared_sf(1, max(gain, 0.0)) > _LEVEL or Whiteness.of(errors).p_value < _COLOURED:
            return none
        variances = np.diag(covariance).copy()
        scale = np.sqrt(variances + tau * speeds**2)
        if np.max(np.abs(residuals) / scale) > _WILD:
            return none
        return StampJitter(float(np.sqrt(tau)), variances, speeds)

    def __str__(self) -> str:
        """Say what it is."""
        return f"stamps that scatter by {1e6 * self.sd_s:.2g} us"


def is_any(jitters: Sequence[StampJitter]) -> bool:
    """Return whether the stamps of any record scatter."""
    return any(own.sd_s > 0.0 for own in jitters)


@dataclass(frozen=True, eq=False)
class _Instants:
    """Residuals and speeds by which outputs were seen together."""

    residuals: FloatArray
    speeds: FloatArray
    seen: BoolArray
    groups: list[tuple[IndexArray, BoolArray]]
    are_shared: bool

    @staticmethod
    def of(residuals: FloatArray, speeds: FloatArray, seen: BoolArray) -> _Instants:
        kinds, which = np.unique(seen, axis=0, return_inverse=True)
        groups = [(np.flatnonzero(kind), np.ravel(which) == number) for number, kind in enumerate(kinds)]
        rows = np.where(seen, np.arange(len(seen))[:, None], -1)
        shared = SharedNoise.of(list(residuals.T), rows)
        return _Instants(residuals, speeds, seen, [own for own in groups if len(own[0])], shared is not None)

    def covariance(self, left: FloatArray, variance: FloatArray) -> FloatArray:
        """Return C from what errors of the stamps leave and the variance that they keep, shape (n_instants,)."""
        counts = self.seen.T.astype(float) @ self.seen
        total = left.T @ left + (self.speeds * variance[:, None]).T @ self.speeds
        found = total / np.maximum(counts, 1.0)
        sds = np.sqrt(np.maximum(np.diag(found), 1e-300))
        correlation = regular_correlation(found / np.outer(sds, sds)) if self.are_shared else np.eye(len(sds))
        return np.asarray(correlation * np.outer(sds, sds))

    def products(self, covariance: FloatArray) -> tuple[FloatArray, FloatArray, float, float]:
        """Return ``v^T C^-1 r`` and ``v^T C^-1 v`` of every instant, all ``r^T C^-1 r`` and all ``log det C``."""
        s, q, power, size = np.zeros(len(self.seen)), np.zeros(len(self.seen)), 0.0, 0.0
        for outputs, here in self.groups:
            own = covariance[np.ix_(outputs, outputs)]
            r, v = self.residuals[here][:, outputs], self.speeds[here][:, outputs]
            weighed = np.linalg.solve(own, v.T).T
            s[here], q[here] = np.sum(weighed * r, axis=1), np.sum(weighed * v, axis=1)
            power += float(np.sum(r * np.linalg.solve(own, r.T).T))
            size += len(r) * float(np.linalg.slogdet(own)[1])
        return s, q, power, size
