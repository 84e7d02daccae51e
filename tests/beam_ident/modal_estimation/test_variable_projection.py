"""The concentrated likelihood against brute force: its gradient by differences, its covariance unprojected."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from beam_ident import FrequencyRecord, InputSignal, ModalStructure, OutputSignal, Prior, TimeRecord
from beam_ident.modal.line_basis import LineBasis
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal.stacked_regression import Part, StackedRegression
from beam_ident.modal_estimation.variable_projection import _Likelihood, designs, fit_modes

RNG = np.random.default_rng(0)
FREE = Prior(0.0, np.inf)
KNOWN = Prior(1e-4, 1e-3)
START = (np.array([12.0, 40.0]), np.array([0.03, 0.02]))


def time_regression() -> ModalRegression:
    """Return two outputs, one with stamps of its own, under a held force."""
    drive = InputSignal("f", "N", (0.0, 0.01), RNG.standard_normal(500), "zoh")
    stamps = (0.01 * np.arange(20, 480), np.sort(RNG.uniform(0.3, 4.6, 300)))
    outputs = [
        OutputSignal(n, "m", t, 1e-3 * RNG.standard_normal(len(t)), 4e-3)
        for n, t in zip("yz", stamps, strict=True)
    ]
    return ModalRegression([TimeRecord((drive,), tuple(outputs))], ModalStructure("force"))


def line_regression(is_noise_known: bool) -> StackedRegression:
    """Return two outputs over two frequency records, every line with a weight of its own."""
    bases, parts = [], []
    for k, n in enumerate((60, 90)):
        omegas = np.linspace(4.0, 60.0, n)
        record = FrequencyRecord(omegas, np.ones((n, 2, 1), dtype=complex), None, ("y", "z"), ("f",))
        bases.append(LineBasis(record, ModalStructure("receptance"), is_late=True))
        parts.append([Part(k, RNG.standard_normal(2 * n), RNG.uniform(1.0, 3.0, 2 * n)) for _ in range(2)])
    return StackedRegression(bases, list(zip(*parts, strict=True)), is_noise_known)


CASES = {
    "time record": (time_regression, FREE, KNOWN),
    "lines of known noise": (lambda: line_regression(True), KNOWN, Prior()),
    "lines of unknown noise": (lambda: line_regression(False), FREE, Prior()),
}


@pytest.mark.parametrize("case", CASES)
def test_the_descent_direction_is_minus_the_gradient(case):
    make, latency, rate = CASES[case]
    likelihood = _Likelihood(make(), 2, latency, rate)
    theta = np.concatenate([np.log(START[0]), START[1], [5e-4], [2e-4] * rate.is_free])
    _, direction = likelihood.slope(likelihood.state(theta))
    for place in range(len(theta)):
        step = 1e-6 * np.eye(len(theta))[place]
        ends = [likelihood.state(theta + sign * step).cost for sign in (1.0, -1.0)]
        # Central differences of a cost of about 1e3: 1e-10 of cancellation, 1e-6 of a step.
        assert direction[place] == pytest.approx(-(ends[0] - ends[1]) / 2e-6, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("case", ["lines of known noise", "lines of unknown noise"])
def test_the_covariance_is_the_inverse_of_the_full_information(case):
    make, latency, rate = CASES[case]
    problem = make()
    fit = fit_modes(problem, *START, ClockState(), latency, rate)
    n_theta = fit.n_theta
    information = np.zeros(fit.covariance.shape)
    if np.isfinite(latency.sd):
        information[n_theta - 1, n_theta - 1] = latency.sd**-2
    place = n_theta
    for design, sigma in zip(designs(problem, fit, latency, rate), fit.sigmas, strict=True):
        here = np.append(np.arange(n_theta), place + np.arange(design.shape[1] - n_theta))
        place += design.shape[1] - n_theta
        information[np.ix_(here, here)] += design.T @ design / sigma**2
    scale = 1.0 / np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    spread = np.sqrt(np.diag(inverse))
    np.testing.assert_allclose(
        fit.covariance / np.outer(spread, spread), inverse / np.outer(spread, spread), atol=1e-6
    )


def test_modes_come_in_order_of_frequency_with_what_belongs_to_them():
    problem = time_regression()
    straight = fit_modes(problem, *START, ClockState(), FREE, KNOWN, max_iterations=0)
    crossed = fit_modes(problem, START[0][::-1], START[1][::-1], ClockState(), FREE, KNOWN, max_iterations=0)
    # Other versions of NumPy round logarithm and exponential otherwise.
    np.testing.assert_allclose(straight.omegas, START[0], rtol=1e-15)
    np.testing.assert_array_equal(crossed.zetas, START[1])
    for one, other in zip(straight.coefficients, crossed.coefficients, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-6)
    spread = np.sqrt(np.diag(straight.covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(crossed.covariance)), spread, rtol=1e-6)


def test_free_motions_that_hardly_differ_leave_the_descent_direction_exact():
    # Slow modes after a gap near the end: their free motions hardly differ there, and have huge coefficients.
    rng = np.random.default_rng(0)
    held = rng.standard_normal(1000)
    held[600:945] = np.nan
    drive = InputSignal("f", "N", (0.0, 0.01), held, "zoh")
    values = np.cumsum(rng.standard_normal(980))
    output = OutputSignal("y", "m", 0.01 * np.arange(10, 990), values)
    regression = ModalRegression([TimeRecord((drive,), (output,))], ModalStructure("receptance"))
    likelihood = _Likelihood(regression, 5, Prior(), Prior())
    theta = np.concatenate([np.log([2.5, 3.2, 4.0, 5.1, 6.7]), np.full(5, 0.03)])
    state = likelihood.state(theta)
    information, direction = likelihood.slope(state)
    for place, sd in enumerate(1.0 / np.sqrt(np.diag(information))):
        step = 0.01 * sd * np.eye(len(theta))[place]
        ends = [likelihood.state(theta + sign * step).cost for sign in (1.0, -1.0)]
        # In units of a standard deviation; rounding times coefficients would be ten of them.
        assert sd * direction[place] == pytest.approx(-50.0 * (ends[0] - ends[1]), abs=0.01)


def test_a_damping_ratio_that_ends_where_its_search_does_is_no_optimum():
    force = np.random.default_rng(3).standard_normal(500)
    lagging = lfilter([0.1], [1.0, -0.9], force)  # a real pole at 10.5 rad/s, which no mode has
    record = TimeRecord(
        (InputSignal("f", "N", (0.0, 0.01), force, "zoh"),), (OutputSignal("y", "m", (0.0, 0.01), lagging),)
    )
    fit = fit_modes(
        ModalRegression([record], ModalStructure("receptance")),
        np.array([8.0]),
        np.array([0.3]),
        ClockState(0.0, 0.0),
        Prior(),
        Prior(),
    )
    assert fit.zetas[0] == pytest.approx(0.95)
    assert not fit.converged
    assert "ran to the end of its search" in fit.reason
