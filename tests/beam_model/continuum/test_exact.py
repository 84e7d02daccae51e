from __future__ import annotations

import math

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameterError, Damping, PointMass
from beam_model.continuum import exact
from beam_model.continuum.exact import exact_frequency_response
from beam_model.parameters import BeamParameters
from tests.beam_model.rigs import HEIGHTS, strip

TWO_PI = 2.0 * np.pi
BAND = TWO_PI * np.geomspace(0.1, 150.0, 400)
# xi that gives the first mode a damping ratio of 0.5 %, spread uniformly along the strip.
VISCOUS = 2.0 * 0.098125 * 0.005 * 28.462
KELVIN_VOIGT = 2.0 * 0.005 / 28.462


def errors(
    parameters: BeamParameters,
    n_modes: int,
    drive: str,
    quantity: str,
    omega: np.ndarray = BAND,
    share: float = 1.0,
) -> np.ndarray:
    """Error at each height, of u against max(|u|, 0.01), of w against |w|, per hub displacement.

    The largest, or the one that this share of the frequencies stays below: a relative error of w has no bound
    at the zeros of w.
    """
    model = BeamModel(parameters, n_modes).frequency_response(omega, HEIGHTS, drive, quantity).values  # type: ignore[arg-type]
    truth = exact_frequency_response(parameters, omega, HEIGHTS, drive, quantity).values
    if drive == "force":
        hub = exact_frequency_response(parameters, omega, HEIGHTS, drive, "hub").values
        model, truth = model / hub, truth / hub
    floor = 0.01 if quantity == "displacement" else 0.0
    return np.quantile(np.abs(model - truth) / np.maximum(np.abs(truth), floor), share, axis=0)


@pytest.mark.parametrize("drive", ["motion", "force"])
@pytest.mark.parametrize(
    "damping", [Damping(viscous=VISCOUS), Damping(internal=KELVIN_VOIGT), Damping(air=VISCOUS)], ids=str
)
def test_twenty_modes_with_static_correction_are_right_to_a_millionth(drive: str, damping: Damping) -> None:
    assert errors(strip(damping=damping), 20, drive, "displacement").max() < 1e-6


@pytest.mark.verify
@pytest.mark.parametrize("drive", ["motion", "force"])
def test_twenty_modes_are_right_on_a_fine_grid(drive: str) -> None:
    fine = TWO_PI * np.geomspace(0.1, 150.0, 20_000)
    viscous = strip(damping=Damping(viscous=VISCOUS))
    assert np.all(errors(viscous, 20, drive, "displacement", fine) < [3e-7, 1e-8, 2e-8])
    assert np.all(errors(viscous, 20, drive, "deflection", fine, 0.99) < [4e-5, 7e-7, 7e-7])
    internal = strip(damping=Damping(internal=KELVIN_VOIGT))
    assert np.all(errors(internal, 20, drive, "displacement", fine) < [9e-6, 1e-6, 1e-6])
    assert np.all(errors(internal, 20, drive, "deflection", fine) < [9e-4, 4e-6, 4e-6])


def test_a_tip_mass_and_a_compliant_clamp_are_as_exact() -> None:
    parameters = strip(
        tip_mass=3e-3, tip_inertia=1e-6, clamp_stiffness=30.0, damping=Damping(viscous=VISCOUS)
    )
    assert errors(parameters, 20, "motion", "displacement").max() < 3e-6
    assert errors(parameters, 40, "motion", "displacement").max() < 3e-8


@pytest.mark.parametrize("drive", ["motion", "force"])
def test_internal_damping_and_a_compliant_clamp_go_together(drive: str) -> None:
    parameters = strip(clamp_stiffness=30.0, damping=Damping(internal=KELVIN_VOIGT))
    assert errors(parameters, 20, drive, "displacement").max() < 1e-6


def test_the_error_falls_steeply_with_the_number_of_modes() -> None:
    parameters = strip(damping=Damping(viscous=VISCOUS))
    found = np.array([errors(parameters, n, "motion", "displacement") for n in (5, 10, 20, 40)])
    # What is left out after a static correction falls like n^-7 or faster at every height.
    assert np.all(found[:-1] / found[1:] > 2.0**6)


def test_without_the_correction_the_error_hardly_falls() -> None:
    parameters = strip(damping=Damping(viscous=VISCOUS))
    model = BeamModel(parameters, 20).frequency_response(BAND, HEIGHTS, with_residuals=False).values
    truth = exact_frequency_response(parameters, BAND, HEIGHTS).values
    assert np.max(np.abs(model - truth) / np.maximum(np.abs(truth), 0.01)) > 1e-5


def test_series_and_exponentials_are_one_function(monkeypatch: pytest.MonkeyPatch) -> None:
    parameters = strip(
        damping=Damping(viscous=VISCOUS, air=0.1, internal=1e-5), tip_mass=1e-3, clamp_stiffness=9.0
    )
    omega = TWO_PI * np.array([7.0, 8.0, 9.0])
    found = []
    for limit in (2.0, 3.5):
        monkeypatch.setattr(exact, "_MAX_SERIES_ARGUMENT", limit)
        for drive in ("motion", "force"):
            found.append(exact_frequency_response(parameters, omega, HEIGHTS, drive, "deflection").values)
    assert found[0] == pytest.approx(found[2], rel=1e-12)
    assert found[1] == pytest.approx(found[3], rel=1e-12)


def test_at_rest_the_beam_bends_like_its_static_shape() -> None:
    parameters = strip(tip_mass=1e-3, clamp_stiffness=9.0)
    omega = 1e-2
    w = exact_frequency_response(parameters, [omega], HEIGHTS, quantity="deflection").values[0]
    static = BeamModel(parameters, 3).basis.static_shape(np.array(HEIGHTS))
    assert w == pytest.approx(omega**2 * static, rel=1e-6)
    hub = exact_frequency_response(parameters, [omega], [0.1], "force", "hub").values[0, 0]
    assert hub == pytest.approx(-1.0 / (parameters.total_mass * omega**2), rel=1e-6)


@pytest.mark.parametrize("quantity", ["slope", "curvature"])
def test_slopes_and_curvatures_follow(quantity: str) -> None:
    parameters = strip(damping=Damping(viscous=VISCOUS))
    model = BeamModel(parameters, 60).frequency_response(BAND, HEIGHTS, quantity=quantity).values  # type: ignore[arg-type]
    truth = exact_frequency_response(parameters, BAND, HEIGHTS, quantity=quantity).values
    assert np.max(np.abs(model - truth) / np.abs(truth).max(axis=0)) < 1e-7


def collocation(parameters: BeamParameters, omega: float, heights: np.ndarray, size: int = 48) -> np.ndarray:
    """w per hub displacement with gravity: the equation itself at Chebyshev points, for w'''' as a series."""
    cheb = np.polynomial.chebyshev
    x = 0.5 * (1.0 - np.cos(np.pi * (np.arange(size) + 0.5) / size))

    def integrals(points: np.ndarray, order: int) -> np.ndarray:
        """The order-th derivative of w, over [w''(0), w'''(0), series of w'''']."""
        columns = []
        for start in (2, 3):
            power = start - order
            columns.append(points**power / math.factorial(power) if power >= 0 else np.zeros(points.size))
        for k in range(size):
            unit = cheb.Chebyshev.basis(k, domain=[0.0, 1.0])
            columns.append((unit.integ(4 - order, lbnd=0.0) if order < 4 else unit)(points))
        return np.stack(columns, axis=1)

    scale, sign = parameters.time_scale**2, parameters.gravity_sign
    mu = parameters.tip_mass_ratio
    load = sign * parameters.weight_ratio * ((1.0 - x) + mu)
    load_slope = -sign * parameters.weight_ratio
    w = [integrals(x, k) for k in range(5)]
    inside = w[4] + load[:, None] * w[2] + load_slope * w[1] - omega**2 * scale * w[0]
    tip = [integrals(np.ones(1), k)[0] for k in range(4)]
    shear = tip[3] + sign * parameters.weight_ratio * mu * tip[1] + mu * omega**2 * scale * tip[0]
    matrix = np.vstack([inside, tip[2], shear])
    right = np.concatenate([np.full(size, omega**2 * scale), [0.0, -mu * omega**2 * scale]])
    coefficients = np.linalg.solve(matrix, right)
    return integrals(heights / parameters.length, 0) @ coefficients


@pytest.mark.slow
@pytest.mark.parametrize("gravity", ["upright", "hanging"])
@pytest.mark.parametrize("tip_mass", [0.0, 2e-3])
def test_gravity_equals_collocation(gravity: str, tip_mass: float) -> None:
    parameters = strip(gravity=gravity, tip_mass=tip_mass)
    omega = TWO_PI * np.array([0.1, 2.0, 4.0, 6.0, 20.0, 50.0, 100.0, 150.0])
    truth = np.array([collocation(parameters, frequency, np.array(HEIGHTS)) for frequency in omega])
    found = BeamModel(parameters, 40).frequency_response(omega, HEIGHTS, quantity="deflection").values
    assert np.max(np.abs(found - truth) / np.abs(truth).max(axis=1, keepdims=True)) < 1e-7
    # Deflections diverge like 1/(omega_1^2 - omega^2) near a mode: the poles are the same, too.
    close = BeamModel(parameters, 5).natural_frequencies[0]
    below, above = (collocation(parameters, close * f, np.array([0.285]))[0] for f in (1 - 1e-9, 1 + 1e-9))
    assert np.sign(below) != np.sign(above)


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"gravity": "upright"}, "gravity"),
        ({"point_masses": (PointMass(0.1, 1e-3),)}, "point_masses"),
        ({"damping": Damping(ratios=(0.005,))}, "damping.ratios"),
    ],
)
def test_what_has_no_closed_form_is_refused(changes: dict[str, object], name: str) -> None:
    with pytest.raises(BeamParameterError) as caught:
        exact_frequency_response(strip(**changes), [1.0], [0.1])
    assert caught.value.name == name


def test_zero_frequency_is_refused() -> None:
    with pytest.raises(BeamParameterError, match="omegas"):
        exact_frequency_response(strip(), [0.0, 1.0], [0.1])
