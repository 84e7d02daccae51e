"""Natural frequencies and damping from free decays: the logarithmic decrement without peak picking.

A structure that was let go rings as a sum of damped cosines,

    y_j(t) = Re sum_i a_ij e^(p_i t) + offset,      p_i = omega_i (-zeta_i + j sqrt(1 - zeta_i^2))

and the least-squares fit of that sum uses every sample, at any stamps and averaged over any
exposure, where the classical decrement uses two peaks.  Poles are common to all outputs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import require_output, require_whole_number
from beam_ident.data.records import OutputSignal
from beam_ident.data.stored_form import read, require_shapes, written
from beam_ident.errors import EstimationError
from beam_ident.modal_estimation.mode_search import Family, PoleOrder, mode_warnings, search_modes
from beam_ident.modal_estimation.pole_projection import Columns, Part, PoleFit, PoleProblem
from beam_ident.noise.scores import Scores, Whiteness, is_coloured
from beam_ident.numerics.blas_threads import on_one_thread

SCHEMA = 1

_DAMPING = (0.0005, 0.002, 0.006, 0.02, 0.06, 0.2)
_PEAKS = 12
_MOST_FREQUENCIES = 2000
_MIN_SAMPLES = 12
_MOST_MODES = 20
_MAX_MODES = 6


@dataclass(frozen=True, eq=False)
class FreeDecay:
    """Modes of a free decay.

    Attributes
    ----------
    natural_frequencies, natural_frequency_sd : ndarray, shape (n_modes,) -- [rad/s]
    damping_ratios, damping_ratio_sd : ndarray, shape (n_modes,)
    covariance : ndarray, shape (2 n_modes, 2 n_modes) -- of frequencies and damping ratios
    amplitudes : complex ndarray, shape (n_outputs, n_modes)
        At ``start_s``; their real part is the displacement, their size the envelope.
    offsets : ndarray, shape (n_outputs,)
    start_s : float -- instant of the first sample used [s]
    output_names : tuple of str
    times_s, measured, modelled, residuals : tuple of ndarray -- of every output, the samples used
    noise_sd : ndarray, shape (n_outputs,)
    scores : tuple of Scores
    whiteness : tuple of Whiteness
        The standard deviations hold where the residuals are white.
    orders : tuple of PoleOrder
    converged : bool
    reason : str
    iterations : int
    warnings : tuple of str -- what a reader must know before trusting the numbers
    """

    natural_frequencies: FloatArray
    natural_frequency_sd: FloatArray
    damping_ratios: FloatArray
    damping_ratio_sd: FloatArray
    covariance: FloatArray
    amplitudes: ComplexArray
    offsets: FloatArray
    start_s: float
    output_names: tuple[str, ...]
    times_s: tuple[FloatArray, ...]
    measured: tuple[FloatArray, ...]
    modelled: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    noise_sd: FloatArray
    scores: tuple[Scores, ...]
    whiteness: tuple[Whiteness, ...]
    orders: tuple[PoleOrder, ...]
    converged: bool
    reason: str
    iterations: int
    warnings: tuple[str, ...]

    @property
    def frequencies_hz(self) -> FloatArray:
        """Natural frequencies [Hz]."""
        return np.asarray(self.natural_frequencies / (2.0 * np.pi))

    @property
    def logarithmic_decrements(self) -> FloatArray:
        """Logarithm of the ratio of two successive maxima, ``2 pi zeta / sqrt(1 - zeta^2)``."""
        zeta = self.damping_ratios
        return np.asarray(2.0 * np.pi * zeta / np.sqrt(1.0 - zeta**2))

    @property
    def logarithmic_decrement_sd(self) -> FloatArray:
        """Standard deviations of the logarithmic decrements."""
        return np.asarray(2.0 * np.pi * self.damping_ratio_sd / (1.0 - self.damping_ratios**2) ** 1.5)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain lists and numbers, from which it is rebuilt exactly (also through JSON)."""
        return written(self, "free_decay", SCHEMA)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> FreeDecay:
        """Rebuild what ``to_dict`` wrote.

        Raises
        ------
        ModelFormatError
            Another type or schema, a missing entry, or entries that do not agree.
        """
        found = read(FreeDecay, data, "free_decay", SCHEMA)
        n, m = len(found.natural_frequencies), len(found.output_names)
        modal = ("natural_frequency_sd", "damping_ratios", "damping_ratio_sd")
        shapes = {"covariance": (2 * n, 2 * n), "amplitudes": (m, n), "offsets": (m,), "noise_sd": (m,)}
        require_shapes("free decay", found, {**shapes, **dict.fromkeys(modal, (n,))})
        return found


class _DecayBasis:
    """Offset and damped cosines at the stamps of one output."""

    def __init__(self, elapsed: FloatArray, exposure_s: float) -> None:
        self.elapsed, self.exposure_s = elapsed, exposure_s

    def fixed(self, latency: float) -> Columns:
        """Return the constant."""
        del latency
        ones, zeros = np.ones((len(self.elapsed), 1)), np.zeros((len(self.elapsed), 1))
        return Columns(ones, zeros, zeros, zeros)

    def modal(self, omega: float, zeta: float, latency: float) -> Columns:
        """Return cosine and sine of one mode with their derivatives."""
        del latency
        root = math.sqrt(1.0 - zeta**2)
        pole = omega * complex(-zeta, root)
        half = 0.5 * pole * self.exposure_s
        is_short = abs(half) < 1e-4
        shape = 1.0 + half**2 / 6.0 if is_short else np.sinh(half) / half
        log_slope = 0.5 * self.exposure_s * (half / 3.0 if is_short else 1.0 / np.tanh(half) - 1.0 / half)
        value = np.exp(pole * self.elapsed) * shape
        slope = value * (self.elapsed + log_slope)
        pairs = [value, slope * pole, slope * (omega * complex(-1.0, -zeta / root))]
        columns = [np.stack([pair.real, -pair.imag], axis=1) for pair in pairs]
        return Columns(columns[0], columns[1], columns[2], np.zeros_like(columns[0]))

    def scanned(self, omegas: FloatArray, zetas: FloatArray, latency: float) -> FloatArray:
        """Return cosines and sines of candidates."""
        found = [self.modal(float(w), float(z), latency).value for w, z in zip(omegas, zetas, strict=True)]
        return np.stack(found, axis=1)


@on_one_thread
def fit_free_decay(
    outputs: OutputSignal | Sequence[OutputSignal],
    n_modes: int | None = None,
    start_s: float = -math.inf,
    end_s: float = math.inf,
    max_modes: int = _MAX_MODES,
) -> FreeDecay:
    """Fit damped cosines with common poles to free decays, without hints.

    Parameters
    ----------
    outputs : OutputSignal or a sequence of them
        At any stamps; NaN where nothing was seen.
    n_modes : int or None -- None lets the Bayesian information criterion decide
    start_s, end_s : float -- the stretch that rings freely [s]
    max_modes : int

    Raises
    ------
    EstimationError
        Too few samples, an output that is constant, or nothing that rings.

    Notes
    -----
    Frequencies are looked for up to half the mean rate of the stamps.
    """
    signals = tuple(outputs) if isinstance(outputs, list | tuple) else (outputs,)
    if not signals or not all(isinstance(signal, OutputSignal) for signal in signals):
        found = ", ".join(type(signal).__name__ for signal in signals) or "nothing"
        raise EstimationError(
            f"there is {found} to fit a decay to; expected an OutputSignal, or a list of them"
        )
    limit = max_modes if n_modes is None else n_modes
    require_whole_number("max_modes" if n_modes is None else "n_modes", limit, 1, _MOST_MODES)
    kept = [(s.times_s >= start_s) & (s.times_s <= end_s) & s.is_valid for s in signals]
    for signal, keep in zip(signals, kept, strict=True):
        if np.count_nonzero(keep) < max(_MIN_SAMPLES, 3 * limit if n_modes is not None else 0):
            raise EstimationError(
                f"output {signal.name!r}: {np.count_nonzero(keep)} samples between {start_s} and {end_s} s; a "
                f"decay needs at least {_MIN_SAMPLES}, and three for each mode"
            )
    times = [s.times_s[keep] for s, keep in zip(signals, kept, strict=True)]
    values = [s.values[keep] for s, keep in zip(signals, kept, strict=True)]
    for signal, own in zip(signals, values, strict=True):
        require_output(signal.name, own)
    start = min(float(t[0]) for t in times)
    bases = tuple(_DecayBasis(t - start, s.exposure_s) for t, s in zip(times, signals, strict=True))
    sizes = [max(float(np.std(v)), 1e-300) for v in values]
    blocks = tuple(
        (Part(k, v, np.full(len(v), 1.0 / size)),)
        for k, (v, size) in enumerate(zip(values, sizes, strict=True))
    )
    problem = PoleProblem(bases, blocks, is_noise_known=False)
    longest = max(float(t[-1] - t[0]) for t in times)
    rate = max((len(t) - 1) / float(t[-1] - t[0]) for t in times)
    spectrum = _Periodogram(times, longest, rate)
    band = (np.pi / longest, np.pi * rate)
    fit, orders = search_modes(problem, spectrum.proposals, band, n_modes, limit)
    if not len(fit.omegas):
        raise EstimationError(
            f"nothing rings in {', '.join(s.name for s in signals)} ({orders[-1].refused_because}). Give the stretch "
            "of the free decay, or ask for a number of modes to see the best candidate"
        )
    return _result(fit, orders, signals, times, values, np.array(sizes), start, band)


class _Periodogram:
    """Where the residuals ring, over all outputs."""

    def __init__(self, times: list[FloatArray], longest: float, rate: float) -> None:
        count = min(max(int(longest * rate), 8), _MOST_FREQUENCIES)
        self.omegas = np.asarray(np.pi * rate * (np.arange(count) + 1.0) / count)
        self.times = times

    def proposals(self, fit: PoleFit) -> list[Family]:
        """Return the highest peaks, each with every damping."""
        power = np.zeros(len(self.omegas))
        for times, residuals in zip(self.times, fit.residuals, strict=True):
            for first in range(0, len(self.omegas), 256):
                here = slice(first, first + 256)
                turned = np.exp(-1j * self.omegas[here, None] * (times - times[0]))
                power[here] += np.abs(turned @ residuals) ** 2 / max(float(residuals @ residuals), 1e-300)
        padded = np.concatenate([[0.0], power, [0.0]])
        is_peak = (power >= padded[:-2]) & (power >= padded[2:])
        peaks = np.flatnonzero(is_peak)
        peaks = peaks[np.argsort(-power[peaks])][:_PEAKS]
        grid, damping = np.meshgrid(self.omegas[peaks], np.array(_DAMPING), indexing="ij")
        return [(grid.ravel(), damping.ravel())]


def _result(
    fit: PoleFit,
    orders: tuple[PoleOrder, ...],
    signals: tuple[OutputSignal, ...],
    times: list[FloatArray],
    values: list[FloatArray],
    sizes: FloatArray,
    start: float,
    band: tuple[float, float],
) -> FreeDecay:
    n = len(fit.omegas)
    scale = np.concatenate([fit.omegas, np.ones(n)])
    covariance = fit.covariance[: 2 * n, : 2 * n] * np.outer(scale, scale)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    residuals = tuple(size * e for size, e in zip(sizes, fit.residuals, strict=True))
    whiteness = tuple(Whiteness.of(e) for e in residuals)
    warnings = mode_warnings(fit, band)
    coloured = [
        signal.name
        for signal, own, seen, left in zip(signals, whiteness, values, residuals, strict=True)
        if is_coloured(own, seen, left)
    ]
    if coloured:
        warnings.append(
            f"the residuals of {', '.join(coloured)} are not white, and the standard deviations take them to be: "
            "modes are missing, the noise is coloured, or what was seen is no free decay"
        )
    return FreeDecay(
        natural_frequencies=fit.omegas,
        natural_frequency_sd=sd[:n],
        damping_ratios=fit.zetas,
        damping_ratio_sd=sd[n:],
        covariance=covariance,
        amplitudes=fit.coefficients[:, 1::2] + 1j * fit.coefficients[:, 2::2],
        offsets=fit.coefficients[:, 0],
        start_s=start,
        output_names=tuple(s.name for s in signals),
        times_s=tuple(times),
        measured=tuple(values),
        modelled=tuple(y - e for y, e in zip(values, residuals, strict=True)),
        residuals=residuals,
        noise_sd=np.sqrt(fit.variances) * sizes,
        scores=tuple(Scores.of(y, e) for y, e in zip(values, residuals, strict=True)),
        whiteness=whiteness,
        orders=orders,
        converged=fit.converged,
        reason=fit.reason,
        iterations=fit.iterations,
        warnings=tuple(warnings),
    )
