"""How nonlinear a structure is, from the lines that were not excited.

A multisine that leaves lines out, all even ones and some of the odd ones (random-odd), makes a
nonlinear structure answer where nobody asked: even nonlinearities on even lines, odd ones on the
odd detection lines, where a linear one shows its noise alone (Pintelon and Schoukens 2012,
ch. 4).  The noise is known from the scatter between periods, so that the comparison is an
F test: over n detection lines and P periods,

    F = sum P |mean Y|^2 / s  /  sum var Y / s      ~  F(2 n, 2 n (P - 1))

where s is the noise's level, smoothed over many neighbouring lines.  Distortion of the same size as on the detection
lines stands on the excited ones too, where it biases the response.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import fdtrc as f_sf
from scipy.special import fdtri as f_ppf

from beam_ident.arrays import ComplexArray, IndexArray
from beam_ident.errors import EstimationError
from beam_ident.responses.periodic_averaging import PeriodicResponse
from beam_ident.responses.periods import mean_of_neighbours

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
    n_lines : int -- detection lines, of all realisations together
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


def nonlinear_distortion(
    found: PeriodicResponse | Sequence[PeriodicResponse], significance: float = 0.01
) -> NonlinearDistortion:
    """Judge from the detection lines whether a structure is linear.

    Parameters
    ----------
    found : PeriodicResponse or sequence of PeriodicResponse
        Of a multisine with lines left out, in steady state; of several realisations, judged together.
    significance : float
        Chance of calling a linear structure nonlinear, shared by all outputs and both parities.

    Raises
    ------
    EstimationError
        A level outside (0, 1), an excitation without detection lines, or realisations of other outputs.

    Notes
    -----
    What a measured input itself has on the detection lines is taken away through the
    response, interpolated from the neighbouring excited lines.  A transient that has not died
    out answers on all lines too: ``PeriodicResponse.drift`` far above 1 says so.
    """
    all_found: list[PeriodicResponse] = list(found) if isinstance(found, Sequence) else [found]
    for one in all_found:
        if not isinstance(one, PeriodicResponse):
            raise EstimationError(
                f"found is a {type(one).__name__}; expected what periodic_response() returns"
            )
    if not all_found or any(
        one.response.output_names != all_found[0].response.output_names for one in all_found
    ):
        raise EstimationError(
            f"{len(all_found)} periodic responses, not all of the same outputs; expected one or several of the same"
        )
    if not 0.0 < significance < 1.0:
        raise EstimationError(f"significance is {significance}; expected a number between 0 and 1")
    parities: tuple[tuple[Parity, int], ...] = (("even", 0), ("odd", 1))
    rests = [detection_lines(one) for one in all_found]
    sets = [
        (parity, [lines[one.bins[lines] % 2 == rest] for one, lines in zip(all_found, rests, strict=True)])
        for parity, rest in parities
    ]
    sets = [(parity, lines) for parity, lines in sets if sum(map(len, lines))]
    if not sets:
        raise EstimationError(
            "every line between the first and the last is excited, so that none can show distortion; excite odd "
            "lines only and leave some of them out (a random-odd multisine)"
        )
    names = all_found[0].response.output_names
    own = significance / (len(sets) * len(names))
    levels = []
    for j, name in enumerate(names):
        for parity, lines in sets:
            levels.append(_level(name, j, parity, all_found, lines, own))
    is_nonlinear = any(level.is_detected for level in levels)
    return NonlinearDistortion(
        tuple(levels), significance, is_nonlinear, _verdict(levels, all_found, significance)
    )


def detection_lines(found: PeriodicResponse) -> IndexArray:
    """Return the places in ``found.bins`` of lines that are not excited, between the first and the last that is."""
    excited = np.flatnonzero(found.is_excited)
    inside = np.arange(excited[0], excited[-1] + 1)
    return np.asarray(inside[~found.is_excited[inside]])


def periods_without_input(
    found: PeriodicResponse,
    j: int,
    lines: IndexArray,
    known: tuple[IndexArray, ComplexArray] | None = None,
) -> ComplexArray:
    """Return amplitudes of output ``j`` at detection lines less what the input itself has there, period by period.

    Parameters
    ----------
    found : PeriodicResponse
    j : int -- which output
    lines : ndarray of int -- places in ``found.bins``
    known : (places in ``found.bins``, response of output j there), optional
        A response that is better known than by these periods alone, as that of several realisations.

    Returns
    -------
    complex ndarray, shape (n_periods, n_lines)

    Notes
    -----
    Of a loop, noise and distortion come back through the input. Taken away period by period, what is left scatters as
    it would without the loop.
    """
    amplitudes = np.asarray(2.0 * found.bin_outputs[j][:, lines])
    drives = 2.0 * found.bin_inputs
    size = np.sqrt(np.mean(np.abs(drives) ** 2, axis=0))
    if known is None:
        excited = np.flatnonzero(found.is_excited & (np.abs(found.input_spectrum) > 0.0))
        response = found.spectrum[excited, j] / found.input_spectrum[excited]
    else:
        excited, response = known
    if len(excited):
        for k in np.flatnonzero(size[lines] > _SILENT * np.max(size)):
            amplitudes[:, k] -= _between(lines[k], excited, response) * drives[:, lines[k]]
    return amplitudes


def _between(line: int, excited: IndexArray, response: ComplexArray) -> complex:
    """Return the response at a line from its neighbours: (b0 + b1 x) / (1 + a1 x + a2 x^2), as near a resonance."""
    nearest = np.sort(np.argsort(np.abs(excited - line), kind="stable")[:_NEIGHBOURS])
    x = (excited[nearest] - line) / max(float(np.max(np.abs(excited[nearest] - line))), 1.0)
    values = response[nearest]
    if len(nearest) < _NEIGHBOURS:
        return complex(np.interp(0.0, x, values.real), np.interp(0.0, x, values.imag))
    matrix = np.stack([np.ones(len(x)), x, -values * x, -values * x**2], axis=1)
    return complex(np.linalg.lstsq(matrix, values, rcond=1e-10)[0][0])


def _level(
    name: str,
    j: int,
    parity: Parity,
    found: Sequence[PeriodicResponse],
    lines: Sequence[IndexArray],
    significance: float,
) -> DistortionLevel:
    top = bottom = freedom = power = noise = reference = 0.0
    n = 0
    for one, own in zip(found, lines, strict=True):
        more = one.n_periods - 1
        amplitudes = periods_without_input(one, j, own)
        mean = np.mean(amplitudes, axis=0)
        at_rest = np.sum(np.abs(amplitudes - mean) ** 2, axis=0) / more
        variance = one.spectrum_variance[:, j]
        excited = np.abs(one.spectrum[one.is_excited, j]) ** 2
        floor = _SILENT**2 * float(np.mean(excited)) + 1e-300  # what rounding leaves is no distortion
        smooth = np.maximum(mean_of_neighbours(variance, int(np.ceil(_SMOOTHING / more))), floor)[own]
        own_power = np.abs(mean) ** 2
        top += float(np.sum(one.n_periods * own_power / smooth))
        bottom += more * float(np.sum(np.maximum(at_rest, floor) / smooth))
        freedom += 2.0 * len(own) * more
        n += len(own)
        power += float(np.sum(own_power))
        noise += float(np.sum(at_rest)) / one.n_periods
        reference += float(np.mean(excited - variance[one.is_excited] / one.n_periods)) / len(found)
    statistic = top / n / (2.0 * bottom / freedom)
    power, noise = power / n, noise / n
    # A distortion of excess E makes the statistic (1 + E / noise) times an F variate.
    largest = max(statistic / float(f_ppf(2.0 * n, freedom, 0.05)) - 1.0, 0.0) * noise
    floor = max(reference, 1e-300)
    p_value = float(f_sf(2.0 * n, freedom, statistic))
    return DistortionLevel(
        output_name=name,
        parity=parity,
        n_lines=n,
        level_db=_decibel(max(power - noise, 0.0) / floor),
        largest_db=_decibel(largest / floor),
        noise_db=_decibel(noise / floor),
        statistic=statistic,
        p_value=p_value,
        is_detected=p_value < significance,
    )


def _decibel(ratio: float) -> float:
    return 10.0 * float(np.log10(ratio)) if ratio > 0.0 else -np.inf


def _verdict(levels: list[DistortionLevel], found: Sequence[PeriodicResponse], significance: float) -> str:
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
    drift = max(float(np.nanmax(one.drift, initial=0.0)) for one in found)
    if drift > 2.0:
        words += (
            f"; the periods still change ({drift:.1f} times the noise), so that a transient may add to this"
        )
    return words
