"""How nonlinear a structure is, from the lines that were not excited.

A multisine that leaves lines out, all even ones and some of the odd ones (random-odd), makes a
nonlinear structure answer where nobody asked: even nonlinearities on even lines, odd ones on the
odd detection lines, where a linear one shows its noise alone (Pintelon and Schoukens 2012,
ch. 4).  The noise is known from the scatter between periods, so that the comparison is an
F test: over n detection lines and P periods,

    F = sum P |mean Y|^2 / s  /  sum var Y / s      ~  F(2 n, 2 n (P - 1))

where s is the noise's level, smoothed over many lines.  Distortion of the same size as on the detection
lines stands on the excited ones too, where it biases the response.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import fdtrc as f_sf
from scipy.special import fdtri as f_ppf

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.errors import EstimationError
from beam_ident.responses.periodic_averaging import PeriodicResponse

Parity = Literal["even", "odd"]

_SMOOTHING = 400.0  # degrees of freedom of the smoothed noise level: with few, it takes part in the scatter
_NEIGHBOURS = 6
_SILENT = 1e-9  # of the strongest line: an input below this is at rest


@dataclass(frozen=True)
class DistortionLevel:
    """Distortion of one parity at one output.

    Attributes
    ----------
    output_name : str
    parity : {"even", "odd"}
    n_lines : int -- detection lines
    level_db : float -- distortion's power over the excited lines', line by line on average; -inf for none
    largest_db : float -- 95 % upper bound of the same
    noise_db : float -- power of the averaged noise over the excited lines'
    statistic, p_value : float -- of the F test
    is_detected : bool
    """

    output_name: str
    parity: Parity
    n_lines: int
    level_db: float
    largest_db: float
    noise_db: float
    statistic: float
    p_value: float
    is_detected: bool


@dataclass(frozen=True)
class NonlinearDistortion:
    """The levels at all outputs, and what they mean.

    Attributes
    ----------
    levels : tuple of DistortionLevel
    significance : float -- chance that a linear structure is called nonlinear, over all tests together
    is_nonlinear : bool
    verdict : str
    """

    levels: tuple[DistortionLevel, ...]
    significance: float
    is_nonlinear: bool
    verdict: str


def nonlinear_distortion(found: PeriodicResponse, significance: float = 0.01) -> NonlinearDistortion:
    """Judge from the detection lines whether a structure is linear.

    Parameters
    ----------
    found : PeriodicResponse
        Of a multisine with lines left out, in steady state.
    significance : float
        Chance of calling a linear structure nonlinear, shared by all outputs and both parities.

    Raises
    ------
    EstimationError
        A level outside (0, 1), or an excitation without detection lines.

    Notes
    -----
    What a measured input itself has on the detection lines is taken away through the
    response, interpolated from the neighbouring excited lines.  A transient that has not died
    out answers on all lines too: ``PeriodicResponse.drift`` far above 1 says so.
    """
    if not isinstance(found, PeriodicResponse):
        raise EstimationError(f"found is a {type(found).__name__}; expected what periodic_response() returns")
    if not 0.0 < significance < 1.0:
        raise EstimationError(f"significance is {significance}; expected a number between 0 and 1")
    excited = np.flatnonzero(found.is_excited)
    inside = np.arange(excited[0], excited[-1] + 1)
    detection = inside[~found.is_excited[inside]]
    sets: list[tuple[Parity, IndexArray]] = [
        ("even", detection[found.bins[detection] % 2 == 0]),
        ("odd", detection[found.bins[detection] % 2 == 1]),
    ]
    sets = [(parity, lines) for parity, lines in sets if len(lines)]
    if not sets:
        raise EstimationError(
            "every line between the first and the last is excited, so that none can show distortion; excite odd "
            "lines only and leave some of them out (a random-odd multisine)"
        )
    width = max(1, int(np.ceil(_SMOOTHING / (found.n_periods - 1))))
    names = found.response.output_names
    own = significance / (len(sets) * len(names))
    levels = []
    for j, name in enumerate(names):
        spectrum = _without_input(found, j, detection)
        variance = found.spectrum_variance[:, j]
        smooth = np.maximum(_smoothed(variance, width), 1e-300)
        reference = float(
            np.mean(np.abs(found.spectrum[excited, j]) ** 2 - variance[excited] / found.n_periods)
        )
        for parity, lines in sets:
            power = np.abs(spectrum[lines]) ** 2
            levels.append(
                _level(name, parity, power, variance[lines], smooth[lines], found.n_periods, reference, own)
            )
    is_nonlinear = any(level.is_detected for level in levels)
    return NonlinearDistortion(
        tuple(levels), significance, is_nonlinear, _verdict(levels, found, significance)
    )


def _without_input(found: PeriodicResponse, j: int, detection: IndexArray) -> ComplexArray:
    spectrum = np.array(found.spectrum[:, j])
    drive = found.input_spectrum
    loud = detection[np.abs(drive[detection]) > _SILENT * np.max(np.abs(drive))]
    excited = np.flatnonzero(found.is_excited & (np.abs(drive) > 0.0))
    if len(loud) and len(excited):
        response = found.spectrum[excited, j] / drive[excited]
        for line in loud:
            spectrum[line] -= _between(line, excited, response) * drive[line]
    return spectrum


def _between(line: int, excited: IndexArray, response: ComplexArray) -> complex:
    """Return the response at a line from its neighbours: (b0 + b1 x) / (1 + a1 x + a2 x^2), as near a resonance."""
    nearest = np.sort(np.argsort(np.abs(excited - line), kind="stable")[:_NEIGHBOURS])
    x = (excited[nearest] - line) / max(float(np.max(np.abs(excited[nearest] - line))), 1.0)
    values = response[nearest]
    if len(nearest) < _NEIGHBOURS:
        return complex(np.interp(0.0, x, values.real), np.interp(0.0, x, values.imag))
    matrix = np.stack([np.ones(len(x)), x, -values * x, -values * x**2], axis=1)
    return complex(np.linalg.lstsq(matrix, values, rcond=1e-10)[0][0])


def _smoothed(values: FloatArray, width: int) -> FloatArray:
    kernel = np.ones(min(width, len(values)))
    return np.asarray(
        np.convolve(values, kernel, mode="same") / np.convolve(np.ones(len(values)), kernel, mode="same")
    )


def _level(
    name: str,
    parity: Parity,
    power: FloatArray,
    variance: FloatArray,
    smooth: FloatArray,
    n_periods: int,
    reference: float,
    significance: float,
) -> DistortionLevel:
    n = len(power)
    top, bottom = float(np.sum(n_periods * power / smooth)), float(np.sum(variance / smooth))
    statistic = top / max(bottom, 1e-300)
    freedom = (2 * n, 2 * n * (n_periods - 1))
    p_value = float(f_sf(*freedom, statistic))
    noise = float(np.mean(variance)) / n_periods
    excess = max(float(np.mean(power)) - noise, 0.0)
    # A distortion of excess E makes the statistic (1 + E / noise) times an F variate.
    largest = max(statistic / float(f_ppf(*freedom, 0.05)) - 1.0, 0.0) * noise
    floor = max(reference, 1e-300)
    return DistortionLevel(
        output_name=name,
        parity=parity,
        n_lines=n,
        level_db=_decibel(excess / floor),
        largest_db=_decibel(largest / floor),
        noise_db=_decibel(noise / floor),
        statistic=statistic,
        p_value=p_value,
        is_detected=p_value < significance,
    )


def _decibel(ratio: float) -> float:
    return 10.0 * float(np.log10(ratio)) if ratio > 0.0 else -np.inf


def _verdict(levels: list[DistortionLevel], found: PeriodicResponse, significance: float) -> str:
    detected = [level for level in levels if level.is_detected]
    if not detected:
        bound = max(level.largest_db for level in levels)
        words = (
            f"no nonlinear distortion at the {100 * significance:g} % level: any distortion stays {-bound:.0f} dB "
            "below the excited lines"
        )
    else:
        worst = max(detected, key=lambda level: level.level_db)
        kinds = " and ".join(sorted({level.parity for level in detected}))
        words = (
            f"nonlinear, with {kinds} distortion: up to {worst.level_db:.0f} dB ({worst.parity}, "
            f"{worst.output_name}) of the excited lines, where noise alone is {worst.noise_db:.0f} dB"
        )
    drift = float(np.nanmax(found.drift, initial=0.0))
    if drift > 2.0:
        words += (
            f"; the periods still change ({drift:.1f} times the noise), so that a transient may add to this"
        )
    return words
