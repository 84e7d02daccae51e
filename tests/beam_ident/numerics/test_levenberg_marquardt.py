from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beam_ident.numerics.levenberg_marquardt import HOPELESS, minimise

LOWEST = 10.0


@dataclass(frozen=True)
class Point:
    theta: np.ndarray
    cost: float


class Valley:
    """Rosenbrock's valley as a least-squares problem, lifted by a constant."""

    def state(self, theta: np.ndarray) -> Point:
        return Point(theta, LOWEST + 0.5 * float(np.sum(self.residuals(theta) ** 2)))

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        return np.array([10.0 * (theta[1] - theta[0] ** 2), 1.0 - theta[0]])

    def slope(self, state: Point) -> tuple[np.ndarray, np.ndarray]:
        jacobian = np.array([[-20.0 * state.theta[0], 10.0], [-1.0, 0.0]])
        return jacobian.T @ jacobian, -jacobian.T @ self.residuals(state.theta)

    def limited(self, theta: np.ndarray, step: np.ndarray) -> np.ndarray:
        return theta + step


def found(target: float = np.inf, max_iterations: int = 60):
    valley = Valley()
    return minimise(valley, valley.state(np.array([-1.2, 1.0])), max_iterations, target)


def test_a_curved_valley_is_followed_to_its_end():
    minimum = found()
    assert minimum.converged
    np.testing.assert_allclose(
        minimum.state.theta, 1.0, atol=1e-2
    )  # a thousandth of the standard deviation of 10


def test_a_target_in_reach_changes_nothing():
    np.testing.assert_array_equal(found(LOWEST + 0.1).state.theta, found().state.theta)


def test_a_target_out_of_reach_ends_the_iteration_early():
    minimum = found(LOWEST - 60.0)
    assert not minimum.converged
    assert minimum.reason == HOPELESS
    assert minimum.iterations < found().iterations


def test_iterations_are_bounded_and_never_end_higher_than_they_began():
    minimum = found(max_iterations=3)
    assert not minimum.converged
    assert minimum.iterations == 3
    assert minimum.state.cost < Valley().state(np.array([-1.2, 1.0])).cost


def test_a_start_that_is_not_allowed_is_said_to_be_one():
    minimum = minimise(Valley(), Point(np.zeros(2), np.inf), 10)
    assert not minimum.converged
    assert minimum.reason == "the starting point is not allowed"
    assert minimum.iterations == 0


class Edge(Valley):
    """A bowl whose cost is higher by a thousand beyond a border that runs a little or far before its lowest point."""

    def __init__(self, border: float) -> None:
        self.border = border

    def state(self, theta: np.ndarray) -> Point:
        return Point(theta, super().state(theta).cost + 1e3 * (theta[0] > self.border))

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        return np.array([theta[0], 0.3 * theta[0] - theta[1]])

    def slope(self, state: Point) -> tuple[np.ndarray, np.ndarray]:
        jacobian = np.array([[1.0, 0.0], [0.3, -1.0]])
        return jacobian.T @ jacobian, -jacobian.T @ self.residuals(state.theta)


def test_a_jump_beside_the_optimum_is_an_end_and_one_far_from_it_is_none():
    for border, is_near in ((-0.1, True), (-3.0, False)):
        edge = Edge(border)
        minimum = minimise(edge, edge.state(np.array([-5.0, 4.0])), 40)
        assert minimum.state.theta[0] < border
        assert minimum.converged is is_near
        # Less than a standard deviation from the lowest point costs less than a half.
        assert bool(minimum.state.cost - LOWEST < 0.5) is is_near


class Wall(Valley):
    """A long straight valley, and a wall across it that its lowest point lies behind."""

    jacobian = 100.0 * np.array([[1.0, 1.0], [0.0, 0.02]])

    def residuals(self, theta: np.ndarray) -> np.ndarray:
        return self.jacobian @ (theta - np.array([-5.0, 6.0]))

    def slope(self, state: Point) -> tuple[np.ndarray, np.ndarray]:
        return self.jacobian.T @ self.jacobian, -self.jacobian.T @ self.residuals(state.theta)

    def limited(self, theta: np.ndarray, step: np.ndarray) -> np.ndarray:
        return np.minimum(theta + step, [np.inf, 1.0])


def test_beside_a_parameter_at_its_bound_the_others_reach_their_best():
    wall = Wall()
    minimum = minimise(wall, wall.state(np.array([3.0, 0.0])), 40)
    # A step that the wall merely cuts short creeps along it, for more than 40 iterations.
    assert minimum.converged
    assert minimum.iterations < 20
    # To a thousandth of a standard deviation.
    np.testing.assert_allclose(minimum.state.theta, [0.0, 1.0], atol=1e-5)


def test_a_parameter_leaves_its_bound_where_the_slope_leads_inwards():
    wall = Wall()
    wall.limited = lambda theta, step: np.minimum(theta + step, [np.inf, 8.0])
    minimum = minimise(wall, wall.state(np.array([3.0, 8.0])), 40)
    assert minimum.converged
    # Along the valley it is known to 0.5.
    np.testing.assert_allclose(minimum.state.theta, [-5.0, 6.0], atol=0.02)
