"""Which modes of a free decay are none: multiples of others that what is bent makes of them.

Whatever bends on the way to the samples, the structure or a sensor, makes products of modes: of p_i = a_i e^(s_i t)

    p_1^a conj(p_1)^b p_2^c ..      frequency (a - b) omega_1 + c omega_2 ..,  phase likewise,
                                    decay rate (a + b) sigma_1 + c sigma_2 ..

so that a product decays as fast as all its factors together.  A mode that does all three is listed as a product where
that is more likely than a mode of its own: the density of the differences about nothing, as well as they are known,
against that of a mode which may lie anywhere (Bayes' factor, all products that were compared counted in).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.free_decay_result import Harmonic


class _Product(NamedTuple):
    """What is made of modes: how often each is in frequency and phase, and in the decay rate."""

    makers: tuple[int, ...]
    times: tuple[int, ...]
    factors: tuple[int, ...]


def harmonics_of(fit: ModalFit, highest: float, chance: float = 0.01) -> dict[int, Harmonic]:
    """Return the modes that are products of others, by their places.

    Parameters
    ----------
    fit : ModalFit -- of a free decay, with cosine and sine of every mode
    highest : float -- frequency up to which modes were looked for [rad/s]
    chance : float
        How often at most a mode of its own is taken for a product: a Bayes' factor beyond its inverse is no more
        frequent (Markov's inequality).
    """
    n = len(fit.omegas)
    pairs = zip(fit.coefficients, fit.mode_columns, strict=True)
    sizes = np.array([[np.linalg.norm(found[own[k]]) for k in range(n)] for found, own in pairs]).T
    found: dict[int, Harmonic] = {}
    modes: list[int] = []
    for mode in np.argsort(-sizes.max(axis=1)).tolist():
        # A mode of its own may have any frequency, any phase, and any decay rate up to twice this one.
        room = highest * math.pi * 2.0 * fit.zetas[mode] * fit.omegas[mode]
        compared = [own for own in _products(modes) if np.any(sizes[mode] * _together(sizes, own.makers))]
        odds = [
            (math.log(room / len(compared)) + _log_density(fit, sizes, mode, own), own) for own in compared
        ]
        likeliest, made = max(odds, default=(-math.inf, None))
        if made is None or likeliest < -math.log(chance):
            modes.append(mode)
            continue
        hertz = float(fit.omegas[mode] / (2.0 * np.pi))
        found[mode] = Harmonic(made.makers, made.times, made.factors, hertz, tuple(sizes[mode].tolist()))
    return found


def harmonic_sentences(harmonics: Sequence[Harmonic]) -> list[str]:
    """Return what must be known of products of modes; nothing where there are none."""
    if not harmonics:
        return []
    listed = ", ".join(f"{own.frequency_hz:.6g} Hz ({own.formula})" for own in harmonics)
    return [
        f"No modes but products of modes, by frequency, phase and decay: {listed}. The structure or a sensor is not "
        "linear; amplitude_curves follows frequency and damping over amplitude. Give n_modes to have them among the "
        "modes."
    ]


def _products(modes: Sequence[int], most: int = 6, most_of_two: int = 3) -> Iterator[_Product]:
    """Yield the products of one mode and of two, of so many factors at most."""
    for mode in modes:
        for factors in range(2, most + 1):
            for times in range(factors, 0, -2):
                yield _Product((mode,), (times,), (factors,))
    for pair in itertools.combinations(modes, 2):
        for first, second in itertools.product(range(1, most_of_two), repeat=2):
            if first + second <= most_of_two:
                # The first one forwards: turned about, a product is the same.
                signs = itertools.product(range(first, 0, -2), range(-second, second + 1, 2))
                yield from (_Product(pair, own, (first, second)) for own in signs)


def _together(sizes: FloatArray, makers: Sequence[int]) -> FloatArray:
    """Return the least amplitude of some modes at every output: nothing where one of them does not ring."""
    return np.asarray(np.min(sizes[list(makers)], axis=0))


def _log_density(fit: ModalFit, sizes: FloatArray, mode: int, made: _Product) -> float:
    """Return the logarithm of the density of a mode's frequency, decay rate and phase, were it a product."""
    n = len(fit.omegas)
    output = int(np.argmax(sizes[mode] * _together(sizes, made.makers)))
    places = fit.n_theta + sum(len(own) for own in fit.coefficients[:output]) + fit.mode_columns[output]
    rates, damped = fit.zetas * fit.omegas, fit.omegas * np.sqrt(1.0 - fit.zetas**2)
    pairs = np.array([fit.coefficients[output][own] for own in fit.mode_columns[output]])
    sums, slopes = np.zeros(3), np.zeros((3, len(fit.covariance)))
    # What runs backwards is the same cosine: a product of negative frequency counts with its sign turned.
    forward = 1 if sum(t * damped[k] for k, t in zip(made.makers, made.times, strict=True)) > 0.0 else -1
    parts = [
        (mode, 1, 1),
        *((k, -forward * t, -f) for k, t, f in zip(*made, strict=True)),
    ]
    for own, turns, falls in parts:
        cosine, sine = pairs[own]
        sums += turns * damped[own], falls * rates[own], turns * math.atan2(sine, cosine)
        slopes[0, own] += turns * damped[own]  # by log omega
        slopes[1, [own, n + own]] += falls * rates[own], falls * fit.omegas[own]
        slopes[2, places[own]] += turns * np.array([-sine, cosine]) / (cosine**2 + sine**2)
    sums[2] = math.remainder(sums[2], math.pi)  # a product may be taken away as well as added
    covariance = slopes @ fit.covariance @ slopes.T
    sign, log_volume = np.linalg.slogdet(covariance)
    if sign <= 0.0:
        return -math.inf
    squares = float(sums @ np.linalg.solve(covariance, sums))
    return -0.5 * (squares + float(log_volume) + 3.0 * math.log(2.0 * math.pi))
