"""Clamped modes of a beam with gravity and point masses, from polynomials of high degree.

Gravity makes the equation's coefficients vary along the beam, and a point mass makes the shear force jump;
bare clamped modes then converge like n^-3. Here the beam is cut at its point masses and each piece carries
a cubic Hermite polynomial (deflection and slope at both ends) and bubbles b_k with b_k'' = P_k,
twice-integrated Legendre polynomials, of as high a degree as the highest mode asks for. Convergence is
exponential, bending stiffness is nearly the identity, and all that is left is rounding: the modes are the
clamped modes *with* gravity, markers, tip mass and clamp compliance.

Lengths are in units of L, masses in rho L, stiffnesses in EI/L^3.

Equation numbers are those of docs/beam-model.md.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from scipy import linalg

from beam_model.arrays import FloatArray
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

    Attributes
    ----------
    mass, stiffness : ndarray, shape (n, n)
        Everything that bends: strip, point masses, tip mass and inertia; bending, gravity and clamp spring.
    strip_mass, bending : ndarray, shape (n, n)
        The strip's part alone: int phi_i phi_j and int phi_i'' phi_j''.
    load : ndarray, shape (n,)
        Inertia load under a unit acceleration of the hub: int phi_i + point and tip masses.
    strip_load : ndarray, shape (n,)
        int phi_i.
    """

    def __init__(self, parameters: BeamParameters, n_modes: int) -> None:
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
        # Unknowns: (deflection, slope) of every node but the deflection of the first, then the bubbles.
        n_nodal = 2 * self._nodes.size
        n_all = n_nodal + sum(self._n_bubbles)
        self._kept = np.arange(2 if parameters.clamp_compliance == 0.0 else 1, n_all)

        strip_mass, bending, geometric = (np.zeros((n_all, n_all)) for _ in range(3))
        strip_load = np.zeros(n_all)
        offset = n_nodal
        for index, n_bubbles in enumerate(self._n_bubbles):
            right, length = self._nodes[index + 1], lengths[index]
            points, weights, *tables = _gauss_tables(n_bubbles)
            weights = 0.5 * length * weights
            value, slope, curvature = (
                np.hstack([_hermite_cubics(points, length, k), (length / 2.0) ** 1.5 * tables[k]])
                * (2.0 / length) ** k
                for k in range(3)
            )
            # A point mass loads the beam below it.
            above = mu + sum(mass for x, mass in inner if x >= right)
            axial_load = 1.0 - right + 0.5 * length * (1.0 - points) + above
            rows = np.concatenate(
                [np.arange(2 * index, 2 * index + 4), np.arange(offset, offset + n_bubbles)]
            )
            offset += n_bubbles
            square = np.ix_(rows, rows)
            # The integrals of (B.4), exact by Gauss's rule for these degrees.
            strip_mass[square] += value.T @ (weights[:, None] * value)
            bending[square] += curvature.T @ (weights[:, None] * curvature)
            geometric[square] += slope.T @ ((weights * axial_load)[:, None] * slope)
            strip_load[rows] += weights @ value
        first = self._kept[0]
        self.strip_mass: FloatArray = strip_mass[first:, first:]
        self.bending: FloatArray = bending[first:, first:]
        self.strip_load: FloatArray = strip_load[first:]

        self.mass = self.strip_mass.copy()
        self.load = self.strip_load.copy()
        # Markers and tip of (B.4) act at points.
        for x, mass in [*inner, (1.0, mu)]:
            value = self.basis(np.array([x]))[0]
            self.mass += mass * np.outer(value, value)
            self.load += mass * value
        tip_slope = self.basis(np.array([1.0]), 1)[0]
        self.mass += parameters.tip_inertia_ratio * np.outer(tip_slope, tip_slope)

        # s W of (B.4): an upright beam is softened.
        weight = parameters.gravity_sign * parameters.weight_ratio
        self.stiffness = self.bending - weight * geometric[first:, first:]
        if parameters.clamp_compliance > 0.0:
            root_slope = self.basis(np.array([0.0]), 1)[0]
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
        """Return d^k/dx^k of all basis functions, shape (n_points, n), for k = 0 to 3."""
        x = np.asarray(x, dtype=np.float64)
        piece = np.clip(np.searchsorted(self._nodes, x, side="right") - 1, 0, self._nodes.size - 2)
        result = np.zeros((x.size, 2 * self._nodes.size + sum(self._n_bubbles)))
        offset = 2 * self._nodes.size
        for index, n_bubbles in enumerate(self._n_bubbles):
            rows = np.flatnonzero(piece == index)
            if rows.size:
                length = self._nodes[index + 1] - self._nodes[index]
                xi = 2.0 * (x[rows] - self._nodes[index]) / length - 1.0
                scale = (2.0 / length) ** derivative
                result[rows, 2 * index : 2 * index + 4] = scale * _hermite_cubics(xi, length, derivative)
                # In x the bubbles' second derivatives are orthonormal.
                bubbles = (length / 2.0) ** 1.5 * scale * _bubbles(xi, n_bubbles, derivative)
                result[rows, offset : offset + n_bubbles] = bubbles
            offset += n_bubbles
        return result[:, self._kept]

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


@lru_cache(maxsize=64)
def _gauss_tables(n_bubbles: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return Gauss points and weights that integrate products of bubbles exactly, and the bubbles there."""
    points, weights = legendre.leggauss(n_bubbles + 6)
    value, slope, curvature = (_bubbles(points, n_bubbles, k) for k in range(3))
    return points, weights, value, slope, curvature


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
