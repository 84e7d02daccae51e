"""The exact response of complex poles to a piecewise polynomial.

For ``x' = p x + a(t)`` with ``a`` a polynomial on every segment, the state at the
knots obeys ``x[k+1] = e^(p h) x[k] + sum_m m! h^(m+1) phi_(m+1)(p h) a[k, m]`` with
the phi functions of exponential integrators, and the same formula with a shorter
step gives the state at any instant in between.  Derivatives with respect to ``p``
follow by differentiating the recursion; averages over an exposure by integrating
the differential equation: ``mean(x) = (x(b) - x(a) - int a) / (p (b - a))``.
Nothing is interpolated and nothing depends on how the stamps of the outputs fall.

On a regular grid the recursion is unrolled over blocks of knots: the states inside a
block are a matrix product with the coefficients of the block, and only one state
per block is left to recur.  That is the same sum in another order, several times quicker.

Equation numbers are those of docs/likelihood.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import factorial

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from beam_ident.arrays import ComplexArray, FloatArray, IndexArray
from beam_ident.numerics.piecewise import Instants, PiecewisePolynomial
from beam_ident.numerics.recursions import one_pole

_SERIES_RADIUS = 1.0
_SERIES_TERMS = 17  # 1 / 17! = 3e-15 of the leading term at the edge of the series' disc
_TAYLOR_RADIUS = 4.0  # of |p t|: the largest term is 10, one digit is lost
_BLOCK_WIDTH = 32  # coefficients in a block of knots
_BLOCKS_AT_ONCE = 1 << 15  # what they add stays in the cache
_FEW = 12  # poles up to which a filter for each is quicker than steps of all together
_DENSE = 0.5  # share of the knots above which all states are computed


def phi_functions(z: ComplexArray, highest: int) -> list[ComplexArray]:
    """Return ``phi_0 .. phi_highest`` of exponential integrators at ``z``.

    Notes
    -----
    ``phi_0 = e^z``, ``phi_(k+1)(z) = (phi_k(z) - 1/k!) / z``.  The recursion is run
    upwards where ``|z| > 1`` and downwards from a series where it would cancel
    (Hochbruck and Ostermann, Acta Numerica 2010).
    """
    z = np.asarray(z, dtype=np.complex128)
    large = np.abs(z) > _SERIES_RADIUS
    any_large = bool(np.any(large))
    small_z = np.where(large, 0.0, z) if any_large else z
    # phi_highest(z) = sum_n z^n / (highest + n)!, by Horner's rule.
    series = np.full(z.shape, 1.0 / factorial(highest + _SERIES_TERMS), dtype=np.complex128)
    for n in range(_SERIES_TERMS - 1, -1, -1):
        series = series * small_z + 1.0 / factorial(highest + n)
    results = [series]
    for k in range(highest - 1, -1, -1):
        # Downwards, phi_k = z phi_(k+1) + 1/k!: near zero the upward step subtracts nearly equal numbers.
        results.append(small_z * results[-1] + 1.0 / factorial(k))
    results.reverse()
    if any_large:
        where = z[large]
        current = np.exp(where)
        results[0][large] = current
        for k in range(highest):
            current = (current - 1.0 / factorial(k)) / where
            results[k + 1][large] = current
    return results


def recursion(factor: ComplexArray, drive: ComplexArray, initial: complex) -> ComplexArray:
    """Return the states of ``x[k+1] = factor[k] x[k] + drive[k]`` from ``initial`` on.

    Parameters
    ----------
    factor : ndarray, shape (n,) or of one entry, which all steps share
    drive : ndarray, shape (n,)
    initial : complex

    Returns
    -------
    ndarray, shape (n + 1,)
    """
    n = len(drive)
    states = np.empty(n + 1, dtype=np.complex128)
    states[0] = initial
    if factor.size == 1:
        states[1:] = one_pole(complex(factor.ravel()[0]), drive, initial)
        return states
    # As many blocks as each has steps, all of them from zero at once: row k holds the k-th step of every block.
    length = max(math.isqrt(n), 1)
    n_blocks = -(-n // length)
    rows = np.zeros((2, n_blocks * length), dtype=np.complex128)
    rows[0, :n], rows[1, :n] = factor, drive
    factors, inside = (np.ascontiguousarray(row.reshape(n_blocks, length).T) for row in rows)
    for before, multiplied, after in zip(inside, factors[1:], inside[1:], strict=False):
        after += multiplied * before
    # What a block's first state adds to its later ones; from block to block a recursion is left.
    carried = np.cumprod(factors, axis=0)
    starts, state = np.empty(n_blocks, dtype=np.complex128), complex(initial)
    for block, (carry, gained) in enumerate(zip(carried[-1].tolist(), inside[-1].tolist(), strict=True)):
        starts[block] = state
        state = carry * state + gained
    states[1:] = (inside + carried * starts).T.ravel()[:n]
    return states


@dataclass(frozen=True, eq=False)
class _Weights:
    """What a step of length h does: ``x(h) = e x(0) + sum_m g_m a_m``, and the derivatives by the pole.

    Attributes
    ----------
    carry : ndarray, shape (n_poles, n_orders, n_steps) -- ``e`` and, where asked for, ``de/dp``
    gains : ndarray, shape (n_poles, n_orders, degree + 1, n_steps) -- ``g_m`` and ``dg_m/dp``
    """

    carry: ComplexArray
    gains: ComplexArray

    @staticmethod
    def of(poles: ComplexArray, steps: FloatArray, degree: int, gradients: bool) -> _Weights:
        """Evaluate by the phi functions."""
        phi = phi_functions(poles[:, None] * steps, degree + (2 if gradients else 1))
        shape = (len(poles), 2 if gradients else 1)
        carry = np.empty((*shape, len(steps)), dtype=np.complex128)
        gains = np.empty((*shape, degree + 1, len(steps)), dtype=np.complex128)
        carry[:, 0] = phi[0]
        if gradients:
            # d e^(p h) / dp = h e^(p h).
            carry[:, 1] = steps * phi[0]
        power = np.ones_like(steps)
        for m in range(degree + 1):
            power = power * steps
            scale = factorial(m) * power
            # g_m of (I.2) and dg_m/dp of (I.3).
            gains[:, 0, m] = scale * phi[m + 1]
            if gradients:
                gains[:, 1, m] = scale * steps * (phi[m + 1] - (m + 1) * phi[m + 2])
        return _Weights(carry, gains)

    @staticmethod
    def at(poles: ComplexArray, offsets: FloatArray, degree: int, gradients: bool) -> _Weights:
        """Evaluate at many steps of less than a segment: polynomials in the step, in one product.

        Notes
        -----
        ``e^(pt) = sum_j p^j t^j / j!`` and ``g_m(t) = m! sum_(j>m) p^(j-m-1) t^j / j!``.
        """
        longest = float(np.max(np.abs(offsets)))
        if float(np.ptp(offsets)) <= 4.0 * np.finfo(float).eps * longest:
            return _Weights.of(poles, offsets[:1], degree, gradients)
        radius = float(np.max(np.abs(poles))) * longest
        if radius > _TAYLOR_RADIUS:
            return _Weights.of(poles, offsets, degree, gradients)
        n_terms = 2 * degree + 4
        while radius ** (n_terms - degree - 2) > 1e-17 * factorial(n_terms - degree - 2):
            n_terms += 1
        # Powers of h / longest stay below one; what was divided out stands in ``size``.
        powers = np.empty((n_terms, len(offsets)))
        powers[0] = 1.0
        share = offsets / longest
        for j in range(1, n_terms):
            np.multiply(powers[j - 1], share, out=powers[j])
        n_orders, width = (2, degree + 2) if gradients else (1, degree + 2)
        table = np.zeros((len(poles), n_orders, width, n_terms), dtype=np.complex128)
        raised = poles[:, None] ** np.arange(n_terms)
        for j in range(n_terms):
            size = longest**j / factorial(j)
            for m in range(-1, min(degree, j - 1) + 1):  # m = -1 is the exponential
                scale = size * factorial(max(m, 0))
                table[:, 0, m + 1, j] = scale * raised[:, j - m - 1]
                if gradients and j > m + 1:
                    table[:, 1, m + 1, j] = scale * (j - m - 1) * raised[:, j - m - 2]
        rows = table.reshape(-1, n_terms)
        values = np.empty((len(rows), len(offsets)), dtype=np.complex128)
        values.real = rows.real @ powers
        values.imag = rows.imag @ powers
        split = values.reshape(len(poles), n_orders, width, -1)
        return _Weights(split[:, :, 0], split[:, :, 1:])


@dataclass(frozen=True, eq=False)
class SampledResponses:
    """Responses of several poles at output instants (box averages where there is an exposure).

    Attributes
    ----------
    values : ndarray, shape (n_poles, n) -- the states ``x``
    pole_slopes : ndarray or None, shape (n_poles, n) -- ``dx/dp``
    time_slopes : ndarray or None, shape (n_poles, n) -- ``dx/dt``
    """

    values: ComplexArray
    pole_slopes: ComplexArray | None
    time_slopes: ComplexArray | None


class PoleResponses:
    """States of ``x' = p x + a(t)``, from rest, ready to be sampled anywhere.

    Parameters
    ----------
    poles : ndarray, shape (n_poles,), complex
    drive : PiecewisePolynomial
    gradients : bool
        Whether derivatives with respect to the poles are wanted.
    """

    def __init__(self, poles: ComplexArray, drive: PiecewisePolynomial, gradients: bool = True) -> None:
        self.poles = np.asarray(poles, dtype=np.complex128)
        self.drive = drive
        self.gradients = gradients
        self._knots: _RegularKnots | _IrregularKnots
        if drive.period is not None:
            self._knots = _RegularKnots(self.poles, drive.coefficients, drive.period, gradients)
        else:
            self._knots = _IrregularKnots(self.poles, drive, gradients)

    def _at(self, instants: Instants, gradients: bool) -> ComplexArray:
        """Return the states (and derivatives by the pole) at places inside segments."""
        index, offset = instants.index, instants.offset
        states = self._knots.states(index, 2 if gradients else 1)
        if not len(self.poles) or not np.any(offset):  # every instant is a knot
            return states
        weights = _Weights.at(self.poles, offset, self.drive.degree, gradients)
        # (I.2) and (I.3) from the knot before each instant.
        result = weights.carry[:, :1] * states
        if gradients:
            result[:, 1] += weights.carry[:, 1] * states[:, 0]
        for m, coefficients in enumerate(instants.columns_of(self.drive)):
            result += weights.gains[:, :, m] * coefficients
        return result

    def sample(self, instants: Instants, gradients: bool = True) -> SampledResponses:
        """Return the responses at output instants, averaged over their exposures.

        Parameters
        ----------
        instants : Instants -- located on the knots of the drive
        gradients : bool -- whether derivatives are wanted, where there are any
        """
        gradients = gradients and self.gradients
        states = self._at(instants, gradients)
        poles = self.poles[:, None]
        if instants.exposure_s <= 0.0:
            if not gradients:
                return SampledResponses(states[:, 0], None, None)
            # dx/dt from the differential equation (I.1) itself.
            rate = poles * states[:, 0] + instants.evaluate(self.drive)
            return SampledResponses(states[:, 0], states[:, 1], rate)
        area = instants.evaluate(self.drive, -1)
        n = len(instants.times)
        scale = 1.0 / (poles * instants.exposure_s)
        # (I.4), its derivative by the pole, and by time: the difference of x at both ends.
        difference = states[:, :, n:] - states[:, :, :n]
        mean = (difference[:, 0] - (area[n:] - area[:n])) * scale
        if not gradients:
            return SampledResponses(mean, None, None)
        mean_slope = difference[:, 1] * scale - mean / poles
        return SampledResponses(mean, mean_slope, difference[:, 0] / instants.exposure_s)


class _RegularKnots:
    """States at the knots of a regular grid, block by block."""

    def __init__(self, poles: ComplexArray, coefficients: FloatArray, period: float, gradients: bool) -> None:
        n_segments, n_coefficients = coefficients.shape
        self.n_coefficients = n_coefficients
        self.length = length = _BLOCK_WIDTH // n_coefficients
        n_blocks, width = -(-n_segments // length), length * n_coefficients
        # Zeros fill the last block, and stand for one before the first.
        self.padded = np.zeros((n_blocks + 1) * width)
        self.padded[width : width + coefficients.size] = coefficients.ravel()
        self.blocks = self.padded[width:].reshape(n_blocks, width)
        weights = _Weights.of(poles, np.array([period]), n_coefficients - 1, gradients)
        carry, gains = weights.carry[:, :, 0], weights.gains[:, :, :, 0]
        # What a block's first state, and its coefficients, do 0, 1, .. length knots later.
        later = np.arange(length + 1)
        self.powers = np.empty((*carry.shape, length + 1), dtype=np.complex128)
        self.powers[:, 0] = carry[:, :1] ** later
        # Within a block (I.2) unrolls: the coefficients of knot k arrive at knot l with e^(p T (l - k - 1))
        # g_m; here at the end of the block, the last knot's first.
        reach = self.powers[:, :1, :-1, None] * gains[:, :, None]
        if gradients:
            self.powers[:, 1] = later * period * self.powers[:, 0]
            reach[:, 1] += self.powers[:, 1, :-1, None] * gains[:, 0, None]
        self.reach = reach[:, :, ::-1].reshape(*carry.shape, length * n_coefficients)
        self.first = np.empty((*carry.shape, n_blocks), dtype=np.complex128)
        # What a whole block adds at its end; from block to block a recursion is left.
        factors, states = self.powers[:, 0, length], np.zeros(carry.shape, dtype=np.complex128)
        for begin in range(0, n_blocks, _BLOCKS_AT_ONCE):
            here = slice(begin, begin + _BLOCKS_AT_ONCE)
            gained = _products(self.reach, self.blocks[here])
            states[:, 0] = _recursions(factors, gained[:, 0], states[:, 0], self.first[:, 0, here])
            if gradients:
                # (I.3): the state itself forces its derivative.
                forcing = gained[:, 1]
                forcing += self.powers[:, 1, length, None] * self.first[:, 0, here]
                states[:, 1] = _recursions(factors, forcing, states[:, 1], self.first[:, 1, here])

    def states(self, index: IndexArray, n_orders: int) -> ComplexArray:
        """Return the states at knots, shape (n_poles, n_orders, n)."""
        block, later = np.divmod(index, self.length)
        if len(index):
            first_block, last_block = int(np.min(block)), int(np.max(block)) + 1
            if len(index) > _DENSE * self.length * (last_block - first_block):
                dense = self._all(n_orders, slice(first_block, last_block))
                start, n = int(index[0]) - first_block * self.length, len(index)
                if np.array_equal(index, np.arange(index[0], index[0] + n)):  # one knot after the other
                    return dense[:, :, start : start + n]
                return np.asarray(np.take(dense, index - first_block * self.length, axis=2))
        # A block's worth of coefficients before each knot, without those of the block before its own.
        width = self.blocks.shape[1]
        rows = sliding_window_view(self.padded, width)[index * self.n_coefficients]
        rows[np.arange(width) < width - self.n_coefficients * later[:, None]] = 0.0
        result = _products(self.reach[:, :n_orders], rows)
        powers, first = np.take(self.powers, later, axis=2), np.take(self.first[:, :n_orders], block, axis=2)
        result += powers[:, :1] * first
        if n_orders == 2:
            result[:, 1] += powers[:, 1] * first[:, 0]
        return result

    def _all(self, n_orders: int, which: slice) -> ComplexArray:
        """Return the states at all knots of some blocks."""
        n_poles, length = len(self.powers), self.length
        reach = self.reach[:, :n_orders].reshape(n_poles, n_orders, length, self.n_coefficients)
        # A coefficient acts on later knots only: zeros follow.
        padded = np.concatenate([reach, np.zeros_like(reach)], axis=2)
        kernel = sliding_window_view(padded, length, axis=2)[:, :, length:0:-1]  # (pole, order, to, m, from)
        kernel = np.ascontiguousarray(np.moveaxis(kernel, 4, 2).swapaxes(3, 4))
        inside = kernel.reshape(n_poles, n_orders, self.blocks.shape[1], length)
        blocks, first = self.blocks[which], np.ascontiguousarray(self.first[:, :n_orders, which])
        # Real and imaginary parts stand side by side, so that products with the first states are real ones, too.
        states, begun = np.matmul(blocks, inside.view(np.float64)), first.view(np.float64)
        begun = begun.reshape(*first.shape, 2)
        states += np.matmul(begun, _turned(self.powers[:, :1, :length]))
        if n_orders == 2:
            states[:, 1] += np.matmul(begun[:, 0], _turned(self.powers[:, 1, :length]))
        return np.asarray(states.view(np.complex128).reshape(n_poles, n_orders, len(blocks) * length))


def _products(kernel: ComplexArray, rows: FloatArray) -> ComplexArray:
    """Return kernels (.., n) times real rows (n_rows, n), shape (.., n_rows)."""
    parts = np.stack([kernel.real, kernel.imag]).reshape(-1, kernel.shape[-1]) @ rows.T
    result = np.empty((*kernel.shape[:-1], len(rows)), dtype=np.complex128)
    result.real, result.imag = parts.reshape(2, *result.shape)
    return result


def _turned(factors: ComplexArray) -> FloatArray:
    """Return the matrices that multiply real and imaginary part by complex factors, (..., n) as (..., 2, 2 n)."""
    return np.stack([factors, 1j * factors], axis=-2).view(np.float64)


def _recursions(
    factors: ComplexArray, drives: ComplexArray, initial: ComplexArray, states: ComplexArray
) -> ComplexArray:
    """Fill in ``x[k]`` of ``x[k+1] = factor x[k] + drive[k]``, a row for each factor, and return the one after."""
    if len(factors) <= _FEW:
        last = np.empty(len(factors), dtype=np.complex128)
        for row, (factor, drive) in enumerate(zip(factors, drives, strict=True)):
            found = recursion(np.array([factor]), drive, complex(initial[row]))
            states[row], last[row] = found[:-1], found[-1]
        return last
    columns = np.ascontiguousarray(drives.T)
    found = np.empty((len(columns) + 1, len(factors)), dtype=np.complex128)
    found[0] = initial
    for k, column in enumerate(columns):
        np.multiply(factors, found[k], out=found[k + 1])
        found[k + 1] += column
    states[:] = found[:-1].T
    return np.asarray(found[-1])


class _IrregularKnots:
    """States at knots that follow each other at any distance."""

    def __init__(self, poles: ComplexArray, drive: PiecewisePolynomial, gradients: bool) -> None:
        steps = np.diff(drive.knots)
        self._states = np.zeros((len(poles), 2 if gradients else 1, len(steps)), dtype=np.complex128)
        for number, states in enumerate(self._states):
            weights = _Weights.of(poles[number : number + 1], steps, drive.degree, gradients)
            carry, gains = weights.carry[0], weights.gains[0]
            forcing = np.einsum("omk,km->ok", gains, drive.coefficients)
            # (I.2) and (I.3) from knot to knot, one step of its own length each.
            states[0] = recursion(carry[0], forcing[0], 0.0)[:-1]
            if gradients:
                states[1] = recursion(carry[0], forcing[1] + carry[1] * states[0], 0.0)[:-1]

    def states(self, index: IndexArray, n_orders: int) -> ComplexArray:
        """Return the states at knots, shape (n_poles, n_orders, n)."""
        return np.asarray(np.take(self._states[:, :n_orders], index, axis=2))
