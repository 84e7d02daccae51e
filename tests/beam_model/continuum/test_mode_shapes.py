from __future__ import annotations

import numpy as np
import pytest

from beam_model.continuum.mode_shapes import UniformBeamShapes, clamped_roots, free_hub_roots

# Roots of cos b + 1/cosh b to 20 digits, from arithmetic with 40.
CANTILEVER_ROOTS = {
    1: 1.8751040687119611664,
    2: 4.6940911329741745764,
    3: 7.8547574382376125649,
    4: 10.995540734875466991,
    5: 14.137168391046470581,
}
CASES = [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.3, 0.02, 0.0), (0.3, 0.02, 0.05), (0.0, 0.0, 0.5)]


def quadrature(n_points: int) -> tuple[np.ndarray, np.ndarray]:
    points, weights = np.polynomial.legendre.leggauss(n_points)
    return 0.5 * (points + 1.0), 0.5 * weights


def test_cantilever_roots_are_right_to_the_last_digit() -> None:
    roots = clamped_roots(60)
    for number, value in CANTILEVER_ROOTS.items():
        assert roots[number - 1] == pytest.approx(value, rel=1e-14)
    # High roots: (n - 1/2) pi plus a correction below rounding from n = 12 on.
    high = (np.arange(12, 61) - 0.5) * np.pi
    assert roots[11:] == pytest.approx(high, rel=1e-14)


@pytest.mark.parametrize(
    ("ratio", "root"), [(0.0, 2.365020), (0.5, 2.136176), (1.0, 2.053951), (2.0, 1.985114), (10.0, 1.902167)]
)
def test_free_hub_roots_match_the_table(ratio: float, root: float) -> None:
    assert free_hub_roots(1, ratio)[0] == pytest.approx(root, abs=5e-7)


@pytest.mark.parametrize(("ratio", "root"), [(0.1, 1.722742), (0.5, 1.419964), (1.0, 1.247917)])
def test_tip_mass_roots_match_the_table(ratio: float, root: float) -> None:
    assert clamped_roots(1, ratio)[0] == pytest.approx(root, abs=5e-7)


@pytest.mark.parametrize(("mu", "iota", "gamma"), CASES)
def test_sixty_modes_are_orthogonal(mu: float, iota: float, gamma: float) -> None:
    shapes = UniformBeamShapes(60, mu, iota, gamma)
    x, weights = quadrature(300)
    phi = shapes.evaluate(x)
    tip, slope = shapes.evaluate(1.0)[0], shapes.evaluate(1.0, 1)[0]
    overlap = phi.T @ (weights[:, None] * phi)
    mass = overlap + mu * np.outer(tip, tip) + iota * np.outer(slope, slope)
    assert np.abs(mass - (1.0 + mu) * np.eye(60)).max() < 1e-12
    assert np.abs(overlap - shapes.overlap()).max() < 1e-12


@pytest.mark.parametrize(("mu", "iota", "gamma"), CASES)
def test_closed_form_integrals_equal_quadrature(mu: float, iota: float, gamma: float) -> None:
    shapes = UniformBeamShapes(60, mu, iota, gamma)
    x, weights = quadrature(300)
    phi, curvature = shapes.evaluate(x), shapes.evaluate(x, 2)
    assert np.abs(weights @ phi - shapes.integral()).max() < 1e-13
    assert np.abs(weights @ phi**2 - shapes.squared_integral()).max() < 2e-13
    bending = curvature.T @ (weights[:, None] * curvature)
    scale = np.outer(shapes.roots, shapes.roots) ** 2
    assert np.abs((bending - shapes.curvature_overlap()) / scale).max() < 1e-12


@pytest.mark.parametrize(("mu", "iota", "gamma"), CASES)
def test_shapes_meet_their_boundary_conditions(mu: float, iota: float, gamma: float) -> None:
    shapes = UniformBeamShapes(60, mu, iota, gamma)
    b = shapes.roots
    clamp, tip = (np.array([shapes.evaluate(x, k)[0] for k in range(4)]) for x in (0.0, 1.0))
    assert np.abs(clamp[0]).max() < 1e-13
    assert np.abs((clamp[1] - gamma * clamp[2]) / b**2).max() < 1e-13
    assert np.abs((tip[3] + mu * b**4 * tip[0]) / (b**3 * (1.0 + mu * b))).max() < 1e-13
    assert np.abs((tip[2] - iota * b**4 * tip[1]) / (b**2 * (1.0 + iota * b**3))).max() < 1e-13
    assert np.all(clamp[2] > 0.0)


@pytest.mark.parametrize("derivative", [1, 2, 3])
def test_derivatives_follow_from_each_other(derivative: int) -> None:
    shapes = UniformBeamShapes(8, 0.3, 0.02, 0.05)
    x = np.linspace(0.1, 0.9, 9)
    h = 1e-4
    stencil = (shapes.evaluate(x - 2 * h, derivative - 1) - shapes.evaluate(x + 2 * h, derivative - 1)) / 12.0
    stencil += 8.0 * (shapes.evaluate(x + h, derivative - 1) - shapes.evaluate(x - h, derivative - 1)) / 12.0
    # Fourth-order differences: (b h)^4 / 30 is 4e-13 for the eighth mode; rounding costs eps / (b h).
    assert np.abs((stencil / h - shapes.evaluate(x, derivative)) / shapes.roots**derivative).max() < 1e-11


def test_bare_shapes_are_those_of_the_textbook_while_it_still_holds() -> None:
    shapes = UniformBeamShapes(3)
    x = np.linspace(0.0, 1.0, 11)[:, None]
    b = shapes.roots
    sigma = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
    textbook = np.cosh(b * x) - np.cos(b * x) - sigma * (np.sinh(b * x) - np.sin(b * x))
    assert np.abs(shapes.evaluate(x.ravel()) - textbook).max() < 1e-11


@pytest.mark.parametrize(("mu", "gamma"), [(0.0, 0.0), (0.3, 0.05)])
def test_static_shape_is_the_sum_of_all_modes(mu: float, gamma: float) -> None:
    shapes = UniformBeamShapes(60, mu, 0.0, gamma)
    x = np.linspace(0.0, 1.0, 7)
    tip = shapes.evaluate(1.0)[0]
    load = (shapes.integral() + mu * tip) / (1.0 + mu)
    # The tail of sum b^-5 beyond 60 modes, shear jump included, is below 1e-9.
    assert shapes.evaluate(x) @ (load / shapes.roots**4) == pytest.approx(shapes.static_shape(x), abs=1e-9)
