from __future__ import annotations

import sys

import numpy as np
import pytest
from scipy import signal

from beam_model import BeamModel, BeamModelError, BeamParameterError, Damping
from beam_model.galerkin.linear_forms import state_space
from tests.beam_model.rigs import HEIGHTS, strip

OMEGA = 2.0 * np.pi * np.geomspace(0.5, 300.0, 80)
DAMPINGS = [Damping(ratios=(0.005,)), Damping(ratios=(0.005,), viscous=0.1, air=0.2, internal=1e-5)]
INPUTS = {"acceleration": -1.0, "velocity": 1j, "position": 1.0}


def model(damping: Damping) -> BeamModel:
    return BeamModel(strip(gravity="upright", tip_mass=2e-3, damping=damping), 5)


def expected(beam: BeamModel, hub_input: str, quantity: str) -> np.ndarray:
    """The response as the modal sum gives it, per the input asked for."""
    if hub_input == "force":
        return beam.frequency_response(OMEGA, HEIGHTS, "force", quantity).values  # type: ignore[arg-type]
    has_residuals = hub_input == "acceleration"
    values = beam.frequency_response(OMEGA, HEIGHTS, "motion", quantity, with_residuals=has_residuals).values  # type: ignore[arg-type]
    order = {"acceleration": 2, "velocity": 1, "position": 0}[hub_input]
    return values / (1j * OMEGA[:, None]) ** order


@pytest.mark.parametrize("damping", DAMPINGS, ids=["ratios", "all"])
@pytest.mark.parametrize("quantity", ["displacement", "deflection", "slope", "curvature", "hub"])
@pytest.mark.parametrize("hub_input", ["acceleration", "velocity", "position"])
def test_every_form_is_the_modal_sum(damping: Damping, quantity: str, hub_input: str) -> None:
    beam = model(damping)
    space = state_space(beam, HEIGHTS, hub_input, quantity)  # type: ignore[arg-type]
    truth = expected(beam, hub_input, quantity)
    scale = np.abs(truth)
    assert np.max(np.abs(space.frequency_response(OMEGA) - truth) / scale) < 1e-9
    form = space.pole_residue_form()
    # Driven by position, poles and direct term nearly cancel at low frequency: w is s^2 small there.
    tolerance = 1e-6 if hub_input == "position" else 1e-8
    assert np.max(np.abs(form.frequency_response(OMEGA) - truth) / scale) < tolerance


def test_force_equals_the_modal_sum_but_for_the_reaction_of_the_left_out_modes() -> None:
    beam = model(DAMPINGS[0])
    space = state_space(beam, HEIGHTS, "force")
    low = 2.0 * np.pi * 100.0 > OMEGA
    truth = expected(beam, "force", "displacement")[low]
    found = space.frequency_response(OMEGA)[low]
    # The hub's row carries the left-out modes as rigid mass: 1e-4 of the hub's mass moves by (omega/omega_6)^2.
    assert np.max(np.abs(found - truth) / np.abs(truth).max(axis=1, keepdims=True)) < 1e-3
    form = space.pole_residue_form()
    assert np.max(np.abs(form.frequency_response(OMEGA) / space.frequency_response(OMEGA) - 1.0)) < 1e-7
    assert form.double_integrator == pytest.approx(1.0 / beam.parameters.total_mass, rel=1e-9)
    elastic = form.poles[form.poles.imag > 0.0]
    # The model's own poles have the left-out modes in them, too.
    assert np.sort(np.abs(elastic)) == pytest.approx(beam.free_hub_natural_frequencies, rel=1e-6)


@pytest.mark.parametrize("hub_input", ["acceleration", "velocity", "position", "force"])
@pytest.mark.parametrize("output", [0, 1, 2])
def test_zeros_poles_and_gain_give_the_same_response(hub_input: str, output: int) -> None:
    beam = model(DAMPINGS[0])
    space = state_space(beam, HEIGHTS, hub_input)  # type: ignore[arg-type]
    truth = space.frequency_response(OMEGA)[:, output]
    form = space.zeros_poles_gain(output)
    _, found = signal.freqs_zpk(form.zeros, form.poles, form.gain, OMEGA)
    assert np.max(np.abs(found / truth - 1.0)) < 1e-6
    numerator, denominator = form.polynomials()
    _, found = signal.freqs(numerator, denominator, OMEGA)
    assert np.max(np.abs(found / truth - 1.0)) < 1e-5


def test_the_clamped_modes_are_zeros_of_the_hub_under_force() -> None:
    beam = BeamModel(strip(gravity="upright"), 4)
    zeros = state_space(beam, [0.0], "force", "hub").zeros_poles_gain().zeros
    found = np.sort(zeros.imag[zeros.imag > 1.0])
    assert found == pytest.approx(beam.natural_frequencies, rel=1e-8)


def test_residues_under_acceleration_are_the_model_s() -> None:
    beam = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.005,))), 5)
    form = state_space(beam, HEIGHTS, "acceleration", "deflection").pole_residue_form()
    upper = form.poles.imag > 0.0
    poles, residues = form.poles[upper], form.residues[upper]
    # -r/(s^2 + 2 zeta omega s + omega^2) has the residue -r/(2j Im p) at p.
    assert (
        pytest.approx(beam.motion_residues(HEIGHTS), rel=1e-8)
        == (residues * -2j * poles.imag[:, None]).real.T
    )
    assert form.direct == pytest.approx(-beam.residual_terms(HEIGHTS))


def test_scipy_simulates_what_the_stepper_steps() -> None:
    beam = model(DAMPINGS[0])
    space = state_space(beam, HEIGHTS, "acceleration", "deflection")
    a = np.random.default_rng(1).standard_normal(200)
    discrete = space.to_scipy().to_discrete(1e-3, method="zoh")
    _, y = signal.dlsim(discrete, a)[:2]
    states = beam.motion_stepper(1e-3).run(a)[:-1]
    w = states[:, :5] @ beam.shape(HEIGHTS).T - a[:, None] * beam.residual_terms(HEIGHTS)
    assert y == pytest.approx(w, rel=1e-9, abs=1e-12 * np.abs(w).max())


def test_python_control_gets_named_signals() -> None:
    pytest.importorskip("control", reason="python-control is optional")
    space = state_space(model(DAMPINGS[0]), HEIGHTS, "acceleration")
    system = space.to_control()
    assert system.output_labels == ["displacement_010", "displacement_225", "displacement_285"]
    value = np.asarray(system(1j * OMEGA[40]))[:, 0]
    assert value == pytest.approx(space.frequency_response(OMEGA[40])[0], rel=1e-9)


def test_without_python_control_the_way_out_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(BeamModelError, match="pip install control"):
        state_space(model(DAMPINGS[0]), HEIGHTS).to_control()


def test_an_improper_form_is_refused() -> None:
    with pytest.raises(BeamParameterError, match="differentiate"):
        state_space(model(DAMPINGS[0]), HEIGHTS, "position", with_residuals=True)
    with pytest.raises(BeamParameterError, match="hub_input"):
        state_space(model(DAMPINGS[0]), HEIGHTS, "wind")  # type: ignore[arg-type]
    with pytest.raises(BeamParameterError, match="quantity"):
        state_space(model(DAMPINGS[0]), HEIGHTS, "force", "colour")
