"""Poly-reference least-squares complex frequency estimation (pLSCF): poles of many orders at once.

The response matrix is a right matrix fraction ``H(omega) = B(z) A(z)^-1`` with ``z`` on an arc of the unit
circle that the measured band is stretched over, which keeps the normal equations well
conditioned at any order.  Eliminating the numerators of every output leaves reduced normal
equations for A alone,

    M = sum_o ( T_o - S_o^H R^-1 S_o ),      M [A_0 .. A_p]^T = 0

whose blocks are Toeplitz, so that all orders come from one set of sums over the lines
(Guillaume, Verboven, Vanlanduit, Van der Auweraer and Peeters, IMAC XXI, 2003).  Coefficients
are complex: only the measured band is modelled, not its mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.argument_checks import require_responses, require_whole_number
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.errors import EstimationError

_ARC = 0.95  # of the circle that the band covers; the gap takes what the band does not show


@dataclass(frozen=True, eq=False)
class OrderPoles:
    """Poles of one order that lie in the band and decay.

    Attributes
    ----------
    order : int
    poles : complex ndarray, shape (n_poles,) -- [rad/s], by frequency
    participation : complex ndarray, shape (n_poles, n_inputs) -- of unit length
    """

    order: int
    poles: ComplexArray
    participation: ComplexArray


def polyreference_poles(record: FrequencyRecord, max_order: int) -> tuple[OrderPoles, ...]:
    """Estimate poles and participation factors for every order up to a highest one.

    Parameters
    ----------
    record : FrequencyRecord
        Lines without gaps of NaN; outputs weigh by their own size.
    max_order : int
        Of the matrix polynomial; an order p has p poles for every input.

    Raises
    ------
    EstimationError
        NaN in the response, an order below 1, fewer lines than coefficients.
    """
    n_lines, n_outputs, n_inputs = record.response.shape
    require_whole_number("max_order", max_order, 1)
    if not np.all(np.isfinite(record.response)):
        raise EstimationError(
            f"frequency record {record.name!r} has lines that were not measured; take measured(), which leaves "
            "them out"
        )
    if n_lines * n_outputs < (max_order + 1) * (n_outputs + n_inputs) or n_lines < 3:
        raise EstimationError(
            f"{n_lines} lines cannot carry an order of {max_order}; ask for a lower max_order or measure more lines"
        )
    require_responses(record)
    size = np.sqrt(np.mean(np.abs(record.response) ** 2, axis=(0, 2)))
    response = record.response / np.where(size > 0.0, size, 1.0)[:, None]
    low, high = float(record.omegas[0]), float(record.omegas[-1])
    period = 2.0 * np.pi * _ARC / (high - low)
    angles = (record.omegas - low) * period
    # Sums over the lines of e^(j k angle) times 1, H and H^H H: all that the Toeplitz blocks need.
    lags = np.arange(-max_order, max_order + 1)
    turns = np.exp(1j * np.outer(lags, angles))
    of_one = turns @ np.ones(n_lines)
    of_response = np.einsum("kl,loi->koi", turns, response, optimize=True)
    of_square = np.einsum("kl,loi,loj->kij", turns, np.conj(response), response, optimize=True)
    found = []
    for order in range(1, max_order + 1):
        seen = _of_order(order, max_order, of_one, of_response, of_square, low, high, period)
        if record.decay_rate:  # the window moved them to the left
            poles = seen.poles + record.decay_rate
            still = poles.real < 0.0
            seen = OrderPoles(order, poles[still], seen.participation[still])
        found.append(seen)
    return tuple(found)


def _of_order(
    order: int,
    centre: int,
    of_one: ComplexArray,
    of_response: ComplexArray,
    of_square: ComplexArray,
    low: float,
    high: float,
    period: float,
) -> OrderPoles:
    n = order + 1
    n_inputs = of_square.shape[1]
    # Entry (r, s) of every block holds e^(j (s - r) angle).
    lag = centre + np.arange(n)[None, :] - np.arange(n)[:, None]
    matrix = of_one[lag]
    crossed = -of_response[lag]  # (r, s, output, input)
    square = of_square[lag]  # (r, s, input, input)
    whole = np.transpose(square, (0, 2, 1, 3)).reshape(n * n_inputs, n * n_inputs)
    stacked = np.transpose(crossed, (2, 0, 1, 3)).reshape(-1, n, n * n_inputs)
    wide = np.transpose(stacked, (1, 0, 2)).reshape(n, -1)
    solved = np.linalg.solve(matrix, wide).reshape(n, len(stacked), n * n_inputs)
    reduced = whole - np.einsum("ora,rob->ab", np.conj(stacked), solved, optimize=True)
    # The highest coefficient is the identity: spurious poles then decay no more than physical ones grow.
    head = reduced[: order * n_inputs, : order * n_inputs]
    tail = reduced[: order * n_inputs, order * n_inputs :]
    coefficients = -np.linalg.lstsq(head, tail, rcond=1e-15)[0].reshape(order, n_inputs, n_inputs)
    companion = np.zeros((order * n_inputs, order * n_inputs), dtype=np.complex128)
    companion[: (order - 1) * n_inputs, n_inputs:] = np.eye((order - 1) * n_inputs)
    # Participation factors are left null vectors of A: the companion of its transpose.
    companion[(order - 1) * n_inputs :] = -np.concatenate([c.T for c in coefficients], axis=1)
    roots, vectors = np.linalg.eig(companion)
    with np.errstate(divide="ignore"):
        logarithm = np.log(roots)
    angle = np.mod(logarithm.imag, 2.0 * np.pi)
    # The gap belongs half to either side of the band.
    angle = np.where(angle > np.pi * (1.0 + _ARC), angle - 2.0 * np.pi, angle)
    poles = (logarithm.real + 1j * angle) / period + 1j * low
    frequency = np.abs(poles)
    is_wanted = (poles.real < 0.0) & (poles.imag > 0.0) & (frequency >= low) & (frequency <= high)
    participation = vectors[:n_inputs].T
    chosen = np.flatnonzero(is_wanted)
    chosen = chosen[np.argsort(frequency[chosen])]
    length = np.linalg.norm(participation[chosen], axis=1, keepdims=True)
    return OrderPoles(order, poles[chosen], participation[chosen] / np.where(length > 0.0, length, 1.0))


def residues_at(
    record: FrequencyRecord, poles: ComplexArray, differentiations: int = 0, max_lines: int = 600
) -> ComplexArray:
    """Return residues of given poles by linear least squares, shape (n_poles, n_outputs, n_inputs).

    Parameters
    ----------
    record : FrequencyRecord
    poles : complex ndarray, shape (n_poles,) -- upper ones [rad/s]
    differentiations : int -- 0 for a receptance, 1 for a mobility, 2 for an accelerance
    max_lines : int -- lines beyond this are thinned out: enough to tell shapes apart

    Notes
    -----
    ``H = s^d [ sum_r A_r / (s - p_r) + conj(A_r) / (s - conj(p_r)) + U + L / s^2 ]``.
    """
    keep = np.unique(np.linspace(0, record.n_lines - 1, min(record.n_lines, max_lines)).astype(np.intp))
    s = record.s[keep]
    values = record.response[keep].reshape(len(keep), -1)
    one, other = 1.0 / (s[:, None] - poles), 1.0 / (s[:, None] - np.conj(poles))
    columns = np.concatenate(
        [one + other, 1j * (one - other), np.ones((len(s), 1)), (1.0 / s**2)[:, None]], axis=1
    )
    columns = columns * (s**differentiations)[:, None]
    matrix = np.concatenate([columns.real, columns.imag])
    scale = np.linalg.norm(matrix, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    found = np.linalg.lstsq(matrix / scale, np.concatenate([values.real, values.imag]), rcond=1e-12)[0]
    found = found / scale[:, None]
    n = len(poles)
    return np.asarray((found[:n] + 1j * found[n : 2 * n]).reshape(n, record.n_outputs, record.n_inputs))


def frequencies_and_damping(poles: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Return natural frequencies [rad/s] and damping ratios of poles."""
    omega = np.abs(poles)
    return np.asarray(omega), np.asarray(-poles.real / np.where(omega > 0.0, omega, 1.0))
