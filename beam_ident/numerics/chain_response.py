"""The exact response of a chain of first-order sections for any poles, equal ones included.

``x_1 = s u / (p - p_1)``, ``x_2 = s x_1 / (p - p_2)``, ... with ``s`` the unit of frequency and ``p`` the
Laplace variable: no fraction is split, so that nothing cancels where poles meet.  The
derivatives of a piecewise polynomial are a chain too (of integrators), and both
together are one lower bidiagonal matrix, whose exponential advances states and
signal exactly over any step (its entries are the divided differences of the
exponential at the poles; Opitz 1964).

Equation numbers are those of docs/transfer-function-equations.md.
"""

from __future__ import annotations

import math

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.pole_response import recursion

_TERMS = 16  # of the exponential series, for matrices of norm <= 1/2: 2^-17 / 17! is far below rounding
_GRAIN = 2.0**-40  # of a step: offsets that agree within this share one exponential
_CHUNK = 512


def chain_exponential(poles: ComplexArray, links: FloatArray, steps: FloatArray) -> ComplexArray:
    """Return exp(M h) of a lower bidiagonal matrix for several steps, shape (n_steps, n, n).

    Parameters
    ----------
    poles : complex ndarray, shape (n,) -- diagonal of M [1/s]
    links : ndarray, shape (n - 1,) -- what each state gives to the next [1/s]
    steps : ndarray, shape (n_steps,) -- [s]
    """
    # Scaling and squaring: the series is summed for a step of norm 1/2 or less, and doubled.
    norm = float(np.max(np.abs(poles)) + np.max(np.abs(links), initial=0.0))
    size = norm * float(np.max(np.abs(steps), initial=0.0))
    halvings = max(0, math.ceil(math.log2(size / 0.5))) if size > 0.0 else 0
    step = (steps / 2.0**halvings)[:, None, None]
    identity = np.eye(len(poles), dtype=np.complex128)
    result = np.broadcast_to(identity, (len(steps), *identity.shape))
    for k in range(_TERMS, 0, -1):
        # Horner's rule with M = diag(poles) + links below it, without forming M.
        product = poles[:, None] * result
        product[:, 1:] += links[:, None] * result[:, :-1]
        result = identity + step / k * product
    for _ in range(halvings):
        result = result @ result
    return np.asarray(result)


def chain_impulse_response(poles: ComplexArray, scale: float, times: FloatArray) -> ComplexArray:
    """Return the states of a chain after an impulse of area ``1 / scale`` at 0 s, shape (n, n_times).

    Parameters
    ----------
    poles : complex ndarray, shape (n,) -- in units of ``scale``
    scale : float -- unit of frequency [rad/s]
    times : ndarray, shape (n_times,) -- not negative [s]
    """
    links = np.full(len(poles) - 1, scale)
    states = np.empty((len(poles), len(times)), dtype=np.complex128)
    for first in range(0, len(times), _CHUNK):
        part = slice(first, first + _CHUNK)
        states[:, part] = chain_exponential(poles * scale, links, times[part])[:, :, 0].T
    return states


def chain_response(
    poles: ComplexArray,
    scale: float,
    drive: PiecewisePolynomial,
    integral: PiecewisePolynomial,
    instants: Instants,
) -> ComplexArray:
    """Return the states of a chain, from rest, at output instants, shape (n, n_instants).

    Parameters
    ----------
    poles : complex ndarray, shape (n,) -- in units of ``scale``
    scale : float -- unit of frequency [rad/s]
    drive, integral : PiecewisePolynomial -- the signal and its antiderivative
    instants : Instants -- located on the knots of the drive

    Notes
    -----
    An average over an exposure is the difference of the responses to the antiderivative.
    """
    signal = integral if instants.exposure_s > 0.0 else drive
    n_signal = signal.degree + 1
    # One bidiagonal system: the signal's derivatives, highest first, are integrators in front of the sections
    # of (T.4).
    chain = np.concatenate([np.zeros(n_signal), poles * scale])
    links = np.concatenate([np.ones(n_signal - 1), np.full(len(poles), scale)])
    factorials = np.array([math.factorial(k) for k in range(n_signal)], dtype=np.float64)
    derivatives = (signal.coefficients * factorials)[:, ::-1]  # highest first, as along the chain
    steps = np.array([signal.period]) if signal.period is not None else np.diff(signal.knots)
    advance = chain_exponential(chain, links, steps)
    states = np.zeros((len(poles), len(signal.knots)), dtype=np.complex128)
    for row in range(len(poles)):
        weights = advance[:, n_signal + row]
        forcing = np.einsum(
            "kj,kj->k", np.broadcast_to(weights[:, :n_signal], derivatives.shape), derivatives
        )
        # A section is driven by those before it, whose states are already known at all knots.
        for above in range(row):
            forcing = forcing + weights[:, n_signal + above] * states[above, :-1]
        states[row] = recursion(weights[:, n_signal + row], forcing, 0.0)
    values = _at_instants(chain, links, states, derivatives, instants, float(np.min(steps)))
    if instants.exposure_s > 0.0:
        n = len(instants.times)
        return np.asarray((values[:, n:] - values[:, :n]) / instants.exposure_s)
    return values


def _at_instants(
    chain: ComplexArray,
    links: FloatArray,
    states: ComplexArray,
    derivatives: FloatArray,
    instants: Instants,
    period: float,
) -> ComplexArray:
    index, offset = instants.index, instants.offset
    if not np.any(offset):
        return states[:, index]
    n_signal = derivatives.shape[1]
    grain = _GRAIN * period
    # Stamps of a regular camera fall on few distinct places between the knots: one exponential for each.
    distinct, which = np.unique(np.round(offset / grain), return_inverse=True)
    result = np.empty((len(states), len(index)), dtype=np.complex128)
    for first in range(0, len(index), _CHUNK):
        part = slice(first, first + _CHUNK)
        used, place = np.unique(which[part], return_inverse=True)
        advance = chain_exponential(chain, links, distinct[used] * grain)[place, n_signal:]
        before = np.concatenate([derivatives[index[part]], states[:, index[part]].T], axis=1)
        result[:, part] = np.einsum("kij,kj->ik", advance, before)
    return result
