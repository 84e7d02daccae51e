"""Noise of an input that its own samples hide, from what it leaves at the outputs.

An input that never rests and fills the whole band shows no floor.  But its noise passes through the model like the
input itself, so that residuals have the spectrum ``s_j^2 + sigma^2 |G_j|^2 ..`` with one sigma for all outputs: few
numbers, where an autoregression needs dozens to follow a resonance.  They are found by Whittle's likelihood (Ark.
Mat. 2 (1953), 423), and believed where they explain the residuals better than noise of any colour at every output.

A disturbance that acts where the input does leaves the same, and asks for the same weights.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.records import InputSignal
from beam_ident.modal.model import ModalModel
from beam_ident.noise.outliers import outliers
from beam_ident.noise.relation import innovation_criterion
from beam_ident.sensing.misfit_causes import cubed

_MIN_SAMPLES, _MAX_SAMPLES = 256, 2**16  # of the residuals, which are more than enough for so few numbers
_EVEN = 0.1  # of a period: stamps that scatter by more show no lines
_FOLDS = 2  # bands beyond that of the samples, on each side, which fold into it
_EVIDENCE = 10.0  # difference of BIC: very strong (Kass and Raftery 1995)
_FADED = 0.1  # of a record: what ends abruptly leaks from a resonance into all lines
_BENT = 0.1  # of what is left: more of it that goes with the cube of the input is no noise of it
_STARTS = 8
_RANGE = 30.0  # of the logarithm of a variance, on both sides


@dataclass(frozen=True, eq=False)
class Leftover:
    """What a model leaves of one output in one record.

    Attributes
    ----------
    output : int -- among the model's
    times_s, residuals : ndarray, shape (n,) -- by the input's clock
    exposure_s : float
    drive : InputSignal -- of the record
    """

    output: int
    times_s: FloatArray
    residuals: FloatArray
    exposure_s: float
    drive: InputSignal

    def cleaned(self) -> Leftover:
        """Return as much of it as is enough, about its mean, without outliers, and faded in and out."""
        left = self.residuals[:_MAX_SAMPLES] - np.mean(self.residuals[:_MAX_SAMPLES])
        left[outliers(left)] = 0.0
        window = _fade(len(left))
        left *= window / math.sqrt(float(np.mean(np.square(window))))
        return replace(self, times_s=self.times_s[:_MAX_SAMPLES], residuals=left)


def unseen_noise(model: ModalModel, leftovers: Sequence[Leftover]) -> float:
    """Return the standard deviation of white noise on the samples of an input, 0 where the residuals show none.

    Parameters
    ----------
    model : ModalModel -- of one input
    leftovers : sequence of Leftover
    """
    leftovers = [own.cleaned() for own in leftovers]
    spectra = [_spectrum(model, own) for own in leftovers]
    known = [own for own in spectra if own is not None]
    if not known or len(known) < len(spectra):
        return 0.0
    levels = np.array([[float(np.mean(own)) for own in pair] for pair in known])
    if not np.all(levels > 0.0):
        return 0.0
    powers = [power / level for (power, _), level in zip(known, levels[:, 0], strict=True)]
    gains = [gain / level for (_, gain), level in zip(known, levels[:, 0], strict=True)]

    def cost(logs: FloatArray) -> tuple[float, FloatArray]:
        """Return Whittle's likelihood of the logarithms of sigma^2 and of every output's own variance."""
        total, slope = 0.0, np.zeros(len(logs))
        common, own = math.exp(logs[0]), np.exp(logs[1:])
        for k, (power, gain) in enumerate(zip(powers, gains, strict=True)):
            density = own[k] + common * gain
            ratio = power / density
            total += float(np.sum(np.log(density) + ratio))
            by_density = (1.0 - ratio) / density
            slope[0] += common * float(by_density @ gain)
            slope[1 + k] = own[k] * float(np.sum(by_density))
        return total, slope

    highest = math.log(float(np.min(levels[:, 0] / levels[:, 1])))
    starts = [[highest - down, *[-math.log(2.0)] * len(powers)] for down in np.linspace(0.0, 12.0, _STARTS)]
    bounds = [(highest - _RANGE, highest + _RANGE), *[(-_RANGE, _RANGE)] * len(powers)]
    found = [minimize(cost, start, jac=True, bounds=bounds) for start in starts]
    best = min(found, key=lambda one: float(one.fun))
    # Twice the sum over the positive lines is n (log s^2 + 1) of n samples; the other criterion leaves the 1 out.
    residuals = [own.residuals for own in leftovers]
    n_all = sum(map(len, residuals))
    behind = 2.0 * float(best.fun) + (1 + len(powers)) * math.log(n_all)
    for own, level, power in zip(residuals, levels[:, 0], powers, strict=True):
        behind += len(own) * math.log(level) - 2.0 * len(power)
    is_seen = behind + _EVIDENCE < innovation_criterion(residuals)
    # White noise at every output, which leaves 1 at every line, must do worse by the same lines as well.
    is_seen = is_seen and 2.0 * float(best.fun) + math.log(n_all) + _EVIDENCE < 2.0 * sum(map(len, powers))
    if not is_seen:
        return 0.0
    common, *owns = np.exp(best.x)
    densities = [own + common * gain for own, gain in zip(owns, gains, strict=True)]
    bent = max(_bent_share(model, *pair) for pair in zip(leftovers, densities, strict=True))
    return math.sqrt(common) if bent < _BENT else 0.0


def _bent_share(model: ModalModel, own: Leftover, density: FloatArray) -> float:
    """Return how much of what is left, in units of its noise, goes with the answer to the cube of the input.

    A saturating actuator leaves the colour of a noisy input. Noise is in the cube, too, but little of it: where it is
    5 % of the input, some 0.2 % go with the answer.
    """
    half, (first, last) = 0.5 * own.exposure_s, own.drive.span_s
    instants, rows = np.unique(np.clip(own.times_s, first + half, last - half), return_inverse=True)
    drives = own.drive, cubed(own.drive)
    columns = [model.simulate(drive, instants, own.exposure_s)[rows, own.output] for drive in drives]
    scale = np.sqrt(density)
    faded = [_lines(_fade(len(column)) * (column - np.mean(column))) / scale for column in columns]
    left = _lines(own.residuals) / scale
    basis = np.linalg.qr(np.stack(faded, axis=1))[0]
    return float(np.sum(np.square(np.abs(basis.conj().T @ left))) / np.sum(np.square(np.abs(left))))


def _lines(values: FloatArray) -> ComplexArray:
    """Return the transform at the lines between 0 and half the rate, neither included."""
    return np.asarray(np.fft.rfft(values)[1 : (len(values) + 1) // 2])


def _spectrum(model: ModalModel, own: Leftover) -> tuple[FloatArray, FloatArray] | None:
    """Return the power of residuals at their lines, and what white noise of unit variance on the input adds there."""
    n, steps = len(own.times_s), np.diff(own.times_s)
    if n < _MIN_SAMPLES:
        return None
    period, drive_period = float(np.median(steps)), own.drive.period_s
    if drive_period is None or float(np.max(np.abs(steps - period))) > _EVEN * period:
        return None
    power = np.square(np.abs(_lines(own.residuals))) / n
    lines = np.arange(1, len(power) + 1) / (n * period)
    added = np.zeros(len(lines))
    for fold in range(-_FOLDS, _FOLDS + 1):
        hertz = np.abs(lines + fold / period)
        held = np.sinc(hertz * drive_period) ** (1 if own.drive.hold == "zoh" else 2)
        seen = held * np.sinc(hertz * own.exposure_s)
        response = model.frequency_response(2.0 * np.pi * hertz).response[:, own.output]
        added += np.square(np.abs(response * seen)) * drive_period / period
    return power, added


def _fade(n: int) -> FloatArray:
    """Return the window that fades n samples in and out, by half of ``_FADED`` each (Tukey's)."""
    from_end = np.minimum(np.arange(n), np.arange(n)[::-1]) / (0.5 * _FADED * (n - 1))
    return np.asarray(np.square(np.sin(0.5 * np.pi * np.minimum(from_end, 1.0))))
