"""Timoshenko's theory against finite elements of its own and Huang's frequency equation."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.optimize import brentq

from beam_model import BeamModel, BeamParameters, Damping, PointMass, exact_frequency_response
from beam_model.parameters import STANDARD_GRAVITY
from tests.beam_model.rigs import strip

MARKERS = (PointMass(0.225, 0.02), PointMass(0.285, 0.05))


def thick(thickness: float = 0.03, **changes: Any) -> BeamParameters:
    """A bar of 0.3 m on a light hub; 0.03 m is a tenth of its length."""
    return strip(**{"thickness": thickness, "theory": "timoshenko", "hub_mass": 0.3, **changes})


def lagrange(points: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes of the polynomials through the nodes, shape (n_points, n_nodes)."""
    to_monomials = np.linalg.inv(np.vander(nodes, increasing=True))
    powers = np.arange(nodes.size)
    slopes = np.vander(points, increasing=True, N=nodes.size)[:, :-1] * powers[1:]
    return np.vander(points, increasing=True, N=nodes.size) @ to_monomials, slopes @ to_monomials[1:]


def finite_element_frequencies(parameters: BeamParameters, hub_is_free: bool) -> np.ndarray:
    """Natural frequencies [rad/s]: deflection and angle as polynomials of fourth degree on 28 elements."""
    assert parameters.section is not None
    L, EI, rho = parameters.length, parameters.flexural_rigidity, parameters.mass_per_length
    section = parameters.section
    area, inertia = section.width * section.thickness, section.width * section.thickness**3 / 12.0
    nu = section.poissons_ratio
    kGA = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu) * EI / inertia / (2.0 * (1.0 + nu)) * area
    masses = [*((m.height, m.mass) for m in parameters.point_masses), (L, parameters.tip_mass)]
    edges = np.unique(np.round(np.concatenate([np.linspace(0.0, L, 29), [z for z, _ in masses]]), 9))
    gauss, weights = np.polynomial.legendre.leggauss(8)
    local = np.linspace(-1.0, 1.0, 5)
    value, slope = lagrange(gauss, local)
    n = 4 * (edges.size - 1) + 1
    K, M = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    for element, (low, high) in enumerate(pairwise(edges)):
        half = 0.5 * (high - low)
        z, g = low + half * (gauss + 1.0), half * weights[:, None]
        w = 4 * element + np.arange(5)
        psi = w + n
        along = np.hstack([slope / half, -value])  # w' - psi
        both = np.concatenate([w, psi])
        K[np.ix_(both, both)] += kGA * along.T @ (g * along)
        K[np.ix_(psi, psi)] += EI * slope.T @ (g * slope) / half**2
        load = rho * STANDARD_GRAVITY * (L - z) + sum(m * STANDARD_GRAVITY * (z < at) for at, m in masses)
        K[np.ix_(w, w)] -= parameters.gravity_sign * slope.T @ (g * load[:, None] * slope) / half**2
        M[np.ix_(w, w)] += rho * value.T @ (g * value)
        M[np.ix_(psi, psi)] += rho * inertia / area * value.T @ (g * value)
    for at, mass in masses:
        node = 4 * int(np.argmin(np.abs(edges - at)))
        M[node, node] += mass
    M[2 * n - 1, 2 * n - 1] += parameters.tip_inertia
    fixed = [] if hub_is_free else [0]
    if hub_is_free:
        M[0, 0] += parameters.hub_mass
    if np.isinf(parameters.clamp_stiffness):
        fixed.append(n)
    else:
        K[n, n] += parameters.clamp_stiffness
    kept = np.setdiff1d(np.arange(2 * n), fixed)
    squared = eigh(K[np.ix_(kept, kept)], M[np.ix_(kept, kept)], eigvals_only=True)
    return np.sqrt(np.maximum(squared, 0.0))[1 if hub_is_free else 0 :]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"thickness": 0.003},
        {"tip_mass": 0.2, "tip_inertia": 1e-4},
        {"gravity": "upright", "thickness": 0.002, "poissons_ratio": 0.1},
        {"gravity": "hanging", "point_masses": MARKERS, "tip_mass": 0.1, "clamp_stiffness": 3e4},
    ],
    ids=["bare", "thin", "tip", "upright", "everything"],
)
def test_five_modes_are_those_of_finite_elements(changes: dict[str, Any]) -> None:
    parameters = thick(**changes)
    clamped = finite_element_frequencies(parameters, hub_is_free=False)[:5]
    assert BeamModel(parameters, 5).natural_frequencies == pytest.approx(clamped, rel=1e-7)
    free = finite_element_frequencies(parameters, hub_is_free=True)[:5]
    # Clamped modes as the basis of the free hub converge like n^-7, with shear like n^-5.
    assert BeamModel(parameters, 40).free_hub_natural_frequencies[:5] == pytest.approx(free, rel=1e-6)


def huang(b: float, r: float, s: float) -> float:
    """The frequency equation of a clamped bar, Huang (1961), below the frequency at which sections swing alone."""
    root = np.sqrt((r**2 - s**2) ** 2 + 4.0 / b**2)
    alpha = np.sqrt(0.5 * (-(r**2 + s**2) + root))
    beta = np.sqrt(0.5 * (r**2 + s**2 + root))
    along = (b**2 * (r**2 - s**2) ** 2 + 2.0) * np.cosh(b * alpha) * np.cos(b * beta)
    across = b * (r**2 + s**2) / np.sqrt(1.0 - b**2 * r**2 * s**2) * np.sinh(b * alpha) * np.sin(b * beta)
    return float(2.0 + along - across)


@pytest.mark.parametrize("thickness", [0.003, 0.03, 0.06])
def test_clamped_modes_solve_huangs_equation(thickness: float) -> None:
    parameters = thick(thickness)
    r, s = np.sqrt(parameters.rotary_inertia_ratio), np.sqrt(parameters.shear_compliance)
    trial = np.linspace(1.0, min(130.0, 0.999 / (r * s)), 4000)
    values = [huang(b, r, s) for b in trial]
    ends = [(trial[k], trial[k + 1]) for k in np.flatnonzero(np.diff(np.sign(values)))][:4]
    roots = np.array([brentq(huang, low, high, (r, s), xtol=1e-13) for low, high in ends])
    found = BeamModel(parameters, 8).natural_frequencies * parameters.time_scale
    assert found[: roots.size] == pytest.approx(roots, rel=1e-9)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"tip_mass": 0.2, "tip_inertia": 1e-4, "clamp_stiffness": 3e4},
        {"damping": Damping(viscous=30.0, air=20.0, internal=1e-6)},
    ],
    ids=["bare", "tip and clamp", "damped"],
)
@pytest.mark.parametrize("drive", ["motion", "force"])
@pytest.mark.parametrize("quantity", ["displacement", "curvature"])
def test_modes_sum_to_the_exact_response(changes: dict[str, Any], drive: Any, quantity: Any) -> None:
    parameters = thick(**changes)
    model = BeamModel(parameters, 40)
    omegas = np.geomspace(0.02, 0.9, 25) * model.natural_frequencies[2]
    heights = np.array([0.0, 0.03, 0.2, 0.3])[1:]
    exact = exact_frequency_response(parameters, omegas, heights, drive, quantity).values
    found = model.frequency_response(omegas, heights, drive, quantity).values
    # Shear carries load that the left-out modes hold back statically: convergence is that of n^-4.
    tolerance = 2e-6 if quantity == "displacement" else 3e-4
    assert np.abs(found - exact).max() < tolerance * np.abs(exact).max()


def test_a_thin_strip_is_euler_and_bernoullis() -> None:
    thin = thick(5e-5)
    plain = replace(thin, theory="euler-bernoulli")
    expected = BeamModel(plain, 10).natural_frequencies
    # Shear and rotation take (k r)^2/2 (1 + E/(k G)) of a frequency: 2e-6 of mode 10's.
    assert BeamModel(thin, 10).natural_frequencies == pytest.approx(expected, rel=5e-6)
    omegas = np.geomspace(0.02, 1.3, 20) * expected[0]  # off the resonances, which differ in place
    of_strip = [exact_frequency_response(p, omegas, (0.3,)).values for p in (thin, plain)]
    assert of_strip[0] == pytest.approx(of_strip[1], rel=1e-6)
    assert thin.shear_compliance > 0.0 == plain.shear_compliance
