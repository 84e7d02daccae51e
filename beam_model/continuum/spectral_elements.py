"""Clamped modes of a beam with gravity and point masses, from polynomials of high degree.

Gravity makes the equation's coefficients vary along the beam, and a point mass makes the shear force jump;
bare clamped modes then converge like n^-3. Here the beam is cut at its point masses and each piece carries
a cubic Hermite polynomial (deflection and slope at both ends) and bubbles b_k with b_k'' = P_k,
twice-integrated Legendre polynomials, of as high a degree as the highest mode asks for. Convergence is
exponential, bending stiffness is nearly the identity, and all that is left is rounding: the modes are the
clamped modes *with* gravity, markers, tip mass and clamp compliance.

In Timoshenko's theory w = v + g: bending deflects by v, whose slope is the angle psi = v' of a section, and shear by
g, whose slope is the shear angle. g carries integrated Legendre polynomials, scaled so that its stiffness, too, is
the identity: however thin the strip, nothing locks.

Lengths are in units of L, masses in rho L, stiffnesses in EI/L^3.

Equation numbers are those of docs/beam-equations.md.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from scipy import linalg

from beam_model.arrays import FloatArray, IndexArray
from beam_model.errors import BeamParameterError
from beam_model.parameters import BeamParameters

# Legendre series of cos(b x) on a piece of length h fall off once the degree exceeds b h / 2; 24 more terms
# bring them below rounding (checked in the tests by raising the number).
_DEGREES_BEYOND_WAVES = 24


class SpectralElements:
    """Matrices and fields of the clamped beam in piecewise polynomials.

    Parameters
    ----------
    parameters : BeamParameters
        The beam; its hub does not enter.
    n_modes : int
        How many modes must be right to rounding.
    added_mass : float
        What moves along with the strip without weighing on it, over rho L: the air's mass.

    Attributes
    ----------
    mass, stiffness : ndarray, shape (n, n)
        Everything that bends: strip, point masses, tip mass and inertia; bending, shear, gravity and clamp spring.
    strip_mass, elastic : ndarray, shape (n, n)
        The strip's part alone: int phi_i phi_j; int phi_i'' phi_j'' with what shear stores.
    load : ndarray, shape (n,)
        Inertia load under a unit acceleration of the hub: int phi_i + point and tip masses.
    strip_load : ndarray, shape (n,)
        int phi_i.
    """

    def __init__(self, parameters: BeamParameters, n_modes: int, added_mass: float = 0.0) -> None:
        mu = parameters.tip_mass_ratio
        strip = parameters.mass_per_length * parameters.length
        inner = [
            (m.height / parameters.length, m.mass / strip) for m in parameters.point_masses if m.mass > 0.0
        ]
        cuts = sorted({x for x, _ in inner if x < 1.0})
        self._nodes = np.array([0.0, *cuts, 1.0])
        highest_root = (n_modes + 1.0) * np.pi
        lengths = np.diff(self._nodes)
        self._n_bubbles = [int(np.ceil(0.5 * highest_root * h)) + _DEGREES_BEYOND_WAVES for h in lengths]
        # Unknowns: (deflection, slope) of every node but the deflection of the first, then the bubbles, then what
        # shear adds.
        n_nodal = 2 * self._nodes.size
        self._shears = parameters.shear_compliance > 0.0
        self._n_bending = n_nodal + sum(self._n_bubbles)
        self._n_all = self._n_bending + (sum(n + 1 for n in self._n_bubbles) if self._shears else 0)
        n_all = self._n_all
        self._shear_scale = np.sqrt(parameters.shear_compliance)
        self._kept = np.arange(2 if parameters.clamp_compliance == 0.0 else 1, n_all)

        strip_mass, elastic, geometric, rotary = (np.zeros((n_all, n_all)) for _ in range(4))
        strip_load = np.zeros(n_all)
        for index, n_bubbles in enumerate(self._n_bubbles):
            right, length = self._nodes[index + 1], lengths[index]
            rows = self._rows(index)
            points, weights, *tables = _gauss_tables(n_bubbles)
            weights = 0.5 * length * weights
            value, slope, curvature = (self._local(points, index, k, tables[k]) for k in range(3))
            bends = rows < self._n_bending
            angle, shear = slope * bends, slope * ~bends
            # A point mass loads the beam below it.
            above = mu + sum(mass for x_k, mass in inner if x_k >= right)
            axial_load = 1.0 - right + 0.5 * length * (1.0 - points) + above
            square = np.ix_(rows, rows)
            # The integrals of (B.4) and (B.9), exact by Gauss's rule for these degrees.
            strip_mass[square] += value.T @ (weights[:, None] * value)
            elastic[square] += curvature.T @ (weights[:, None] * curvature)
            geometric[square] += slope.T @ ((weights * axial_load)[:, None] * slope)
            rotary[square] += parameters.rotary_inertia_ratio * (angle.T @ (weights[:, None] * angle))
            strip_load[rows] += weights @ value
            if self._shears:
                elastic[square] += shear.T @ (weights[:, None] * shear) / parameters.shear_compliance
        first = self._kept[0]
        self.strip_mass: FloatArray = strip_mass[first:, first:]
        self.elastic: FloatArray = elastic[first:, first:]
        self.strip_load: FloatArray = strip_load[first:]

        self.mass = (1.0 + added_mass) * self.strip_mass + rotary[first:, first:]
        self.load = (1.0 + added_mass) * self.strip_load
        # Markers and tip of (B.4) act at points.
        for x, mass in [*inner, (1.0, mu)]:
            value = self.basis(np.array([x]))[0]
            self.mass += mass * np.outer(value, value)
            self.load += mass * value
        tip_slope = self.angle(np.array([1.0]))[0]
        self.mass += parameters.tip_inertia_ratio * np.outer(tip_slope, tip_slope)

        # s W of (B.4): an upright beam is softened.
        weight = parameters.gravity_sign * parameters.weight_ratio
        self.stiffness = self.elastic - weight * geometric[first:, first:]
        if parameters.clamp_compliance > 0.0:
            root_slope = self.angle(np.array([0.0]))[0]
            self.stiffness += np.outer(root_slope, root_slope) / parameters.clamp_compliance
        try:
            self._cholesky = linalg.cholesky(self.stiffness, lower=True)
        except linalg.LinAlgError as err:
            raise BeamParameterError(
                "flexural_rigidity",
                parameters.flexural_rigidity,
                "N m^2",
                "an upright beam stiff enough to stand: it buckles under its own weight and tip mass "
                f"(rho g L^3/EI = {parameters.weight_ratio:.4g}; a bare clamped strip buckles at 7.84)",
                "Shorten or stiffen the beam, lighten its tip, or let it hang.",
            ) from err

    def basis(self, x: FloatArray, derivative: int = 0) -> FloatArray:
        """Return d^k/dx^k of all basis functions, shape (n_points, n), for k = 0 to 3; from 2 on of bending alone."""
        x = np.asarray(x, dtype=np.float64)
        piece = np.clip(np.searchsorted(self._nodes, x, side="right") - 1, 0, self._nodes.size - 2)
        result = np.zeros((x.size, self._n_all))
        for index in range(self._nodes.size - 1):
            rows = np.flatnonzero(piece == index)
            if rows.size:
                xi = (
                    2.0 * (x[rows] - self._nodes[index]) / (self._nodes[index + 1] - self._nodes[index]) - 1.0
                )
                polynomials = _polynomials(xi, self._n_bubbles[index], derivative)
                result[np.ix_(rows, self._rows(index))] = self._local(xi, index, derivative, polynomials)
        return result[:, self._kept]

    def angle(self, x: FloatArray) -> FloatArray:
        """Return the angle psi of the sections in all basis functions, shape (n_points, n)."""
        result = self.basis(x, 1)
        result[:, self._kept >= self._n_bending] = 0.0
        return result

    def _rows(self, index: int) -> IndexArray:
        """Return which functions are not zero on a piece: cubics, bubbles, its own of shear, and those below it."""
        offset = 2 * self._nodes.size + sum(self._n_bubbles[:index])
        parts = [np.arange(2 * index, 2 * index + 4), np.arange(offset, offset + self._n_bubbles[index])]
        if self._shears:
            begins = self._n_bending + np.cumsum([0, *(n + 1 for n in self._n_bubbles[:index])])
            parts += [begins[-1] + np.arange(self._n_bubbles[index] + 1), begins[:-1]]
        return np.concatenate(parts)

    def _local(self, xi: FloatArray, index: int, derivative: int, polynomials: _Polynomials) -> FloatArray:
        """Return d^k/dx^k of the functions of ``_rows`` at points of one piece, shape (n_points, n_rows)."""
        length = self._nodes[index + 1] - self._nodes[index]
        scale = (2.0 / length) ** derivative
        # In x the bubbles' second derivatives are orthonormal, and so are shear's first ones over its compliance.
        bubbles, integrated = polynomials
        parts = [
            scale * _hermite_cubics(xi, length, derivative),
            (length / 2.0) ** 1.5 * scale * bubbles,
        ]
        if self._shears:
            size = self._shear_scale * np.sqrt(length / 2.0)
            # The first function of every piece below rises from end to end, and what is above rides on it.
            risen = self._shear_scale * np.sqrt(np.diff(self._nodes)[:index]) * (derivative == 0)
            parts += [size * scale * integrated, np.broadcast_to(risen, (xi.size, index))]
        return np.hstack(parts)

    def solve(self, load: FloatArray) -> FloatArray:
        """Return the static deflection's coefficients under ``load``, shape (n,)."""
        return np.asarray(linalg.cho_solve((self._cholesky, True), load), dtype=np.float64)

    def modes(self, n_modes: int) -> tuple[FloatArray, FloatArray]:
        """Return squared frequencies, shape (n_modes,), and mass-normalised vectors, shape (n, n_modes).

        Notes
        -----
        The eigenproblem is solved for 1/omega^2, whose largest values are the lowest modes, and its vectors
        are then refined (Ogita and Aishima 2018), because a symmetric solver's error is relative to the
        largest eigenvalue and not to each one.
        """
        # With K = L L^T: L^-1 M L^-T has the eigenvalues 1/omega^2.
        half = linalg.solve_triangular(self._cholesky, self.mass, lower=True)
        compliance = linalg.solve_triangular(self._cholesky, half.T, lower=True)
        inverse, vectors = linalg.eigh(0.5 * (compliance + compliance.T))
        order = np.argsort(inverse)[::-1][:n_modes]
        V = linalg.solve_triangular(self._cholesky, vectors[:, order], lower=True, trans="T")
        V = V / np.sqrt(np.einsum("ij,ij->j", V, self.mass @ V))
        squared = 1.0 / inverse[order]
        for _ in range(2):
            # (B.5); each step squares the relative error.
            excess = np.eye(n_modes) - V.T @ self.mass @ V
            stiffness = V.T @ self.stiffness @ V
            squared = np.diag(stiffness) / (1.0 - np.diag(excess))
            gaps = squared[None, :] - squared[:, None]
            np.fill_diagonal(gaps, 1.0)
            step = (stiffness + squared[None, :] * excess) / gaps
            np.fill_diagonal(step, 0.5 * np.diag(excess))
            V = V + V @ step
        return squared, V


# Cubics on [-1, 1] by their coefficients of 1, xi, xi^2, xi^3: value and slope at the left, then at the right.
_CUBICS = (
    np.array([[2.0, -3.0, 0.0, 1.0], [1.0, -1.0, -1.0, 1.0], [2.0, 3.0, 0.0, -1.0], [-1.0, -1.0, 1.0, 1.0]])
    / 4.0
)


def _hermite_cubics(xi: FloatArray, length: float, derivative: int) -> FloatArray:
    """Return the four Hermite cubics on [-1, 1], d^k/dxi^k, with slopes per unit of x, shape (n, 4)."""
    coefficients = _CUBICS * np.array([1.0, 0.5 * length, 1.0, 0.5 * length])[:, None]
    for _ in range(derivative):
        coefficients = coefficients[:, 1:] * np.arange(1.0, coefficients.shape[1])
    return np.asarray(
        np.vander(xi, coefficients.shape[1], increasing=True) @ coefficients.T, dtype=np.float64
    )


_Polynomials = tuple[FloatArray, FloatArray]


@lru_cache(maxsize=64)
def _gauss_tables(n_bubbles: int) -> tuple[FloatArray, FloatArray, _Polynomials, _Polynomials, _Polynomials]:
    """Return Gauss points and weights that integrate products of bubbles exactly, and the polynomials there."""
    points, weights = legendre.leggauss(n_bubbles + 6)
    value, slope, curvature = (_polynomials(points, n_bubbles, k) for k in range(3))
    return points, weights, value, slope, curvature


def _polynomials(xi: FloatArray, n_bubbles: int, derivative: int) -> _Polynomials:
    """Return the bubbles and the functions of shear on [-1, 1], d^k/dxi^k."""
    return _bubbles(xi, n_bubbles, derivative), _integrated(xi, n_bubbles + 1, derivative)


def _integrated(xi: FloatArray, count: int, derivative: int) -> FloatArray:
    """Return the integrals from -1 of sqrt((2k+1)/2) P_k for k = 0 to count - 1, or these themselves; from the second
    derivative on zeros, for shear bends no section. Shape (n, count).
    """
    if derivative >= 2:
        return np.zeros((xi.size, count))
    k = np.arange(count, dtype=np.float64)
    P: FloatArray = np.asarray(legendre.legvander(xi, count), dtype=np.float64)
    values = P[:, :count]
    if derivative == 0:
        # (2k+1) P_k = P_(k+1)' - P_(k-1)'; both ends are zero but for k = 0.
        below = np.column_stack([-np.ones(xi.size), P[:, : count - 1]])
        values = (P[:, 1:] - below) / (2 * k + 1)
    result: FloatArray = np.sqrt((2 * k + 1) / 2.0) * values
    return result


def _bubbles(xi: FloatArray, n_bubbles: int, derivative: int) -> FloatArray:
    """Return the bubbles b_2, b_3 .. on [-1, 1], d^k/dxi^k, shape (n, n_bubbles).

    b_k'' = sqrt((2k+1)/2) P_k, and b_k = b_k' = 0 at both ends.
    """
    k = np.arange(2, n_bubbles + 2, dtype=np.float64)
    P: FloatArray = np.asarray(legendre.legvander(xi, n_bubbles + 3), dtype=np.float64)
    middle = P[:, 2 : n_bubbles + 2]
    if derivative == 0:
        # P_k integrated twice, by (2k+1) P_k = P_(k+1)' - P_(k-1)'.
        up, down = P[:, 4 : n_bubbles + 4], P[:, :n_bubbles]
        value = up / ((2 * k + 1) * (2 * k + 3)) - 2 * middle / ((2 * k - 1) * (2 * k + 3))
        value = value + down / ((2 * k + 1) * (2 * k - 1))
    elif derivative == 1:
        value = np.asarray((P[:, 3 : n_bubbles + 3] - P[:, 1 : n_bubbles + 1]) / (2 * k + 1))
    elif derivative == 2:
        value = middle
    else:
        # P_k' = sum of (2j + 1) P_j over j = k-1, k-3, ...
        slopes = np.zeros_like(P)
        for degree in range(1, P.shape[1]):
            below = slopes[:, degree - 2] if degree >= 2 else 0.0
            slopes[:, degree] = below + (2 * degree - 1) * P[:, degree - 1]
        value = slopes[:, 2 : n_bubbles + 2]
    result: FloatArray = np.sqrt((2 * k + 1) / 2.0) * value
    return result
