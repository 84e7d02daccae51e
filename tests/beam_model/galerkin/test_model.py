from __future__ import annotations

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameterError, Damping, PointMass
from beam_model.continuum.mode_shapes import free_hub_roots
from tests.beam_model.rigs import HEIGHTS, strip

TWO_PI = 2.0 * np.pi


def test_clamped_frequencies_of_the_default_rig() -> None:
    found = BeamModel(strip(), 5).natural_frequencies[:4] / TWO_PI
    assert found == pytest.approx([4.52989, 28.38835, 79.48821, 155.76517], abs=6e-6)


def test_gravity_shifts_the_frequencies_as_the_reference_says() -> None:
    clamped = BeamModel(strip(), 5).natural_frequencies
    upright = BeamModel(strip(gravity="upright"), 5).natural_frequencies
    assert upright[:2] / TWO_PI == pytest.approx([4.384, 28.26], abs=2.5e-3)
    assert upright[2:4] / TWO_PI == pytest.approx([79.36, 155.6], abs=0.04)
    assert 100.0 * (upright / clamped - 1.0)[:3] == pytest.approx([-3.22, -0.45, -0.16], abs=0.006)


def test_markers_shift_the_frequencies_as_the_reference_says() -> None:
    marked = strip(point_masses=(PointMass(0.225, 2e-4),))
    shift = BeamModel(marked, 3).natural_frequencies / BeamModel(strip(), 3).natural_frequencies - 1.0
    assert 100.0 * shift == pytest.approx([-0.58, -0.02, -0.45], abs=0.01)


def test_a_mass_and_gravity_together_move_the_frequency_further_down() -> None:
    free = BeamModel(strip(gravity="upright"), 1).natural_frequencies[0]
    marked = BeamModel(strip(gravity="upright", point_masses=(PointMass(0.285, 1e-3),)), 1)
    assert marked.natural_frequencies[0] < 0.95 * free


@pytest.mark.parametrize("hub_mass", [0.02, 0.8])
def test_free_hub_frequencies_converge_to_the_roots_of_the_free_beam(hub_mass: float) -> None:
    parameters = strip(hub_mass=hub_mass)
    ratio = hub_mass / (parameters.mass_per_length * parameters.length)
    expected = free_hub_roots(3, ratio) ** 2 / parameters.time_scale
    coarse = np.abs(BeamModel(parameters, 5).free_hub_natural_frequencies[:3] / expected - 1.0)
    fine = np.abs(BeamModel(parameters, 40).free_hub_natural_frequencies[:3] / expected - 1.0)
    assert fine.max() < 1e-8
    assert np.all(fine < coarse)


def test_prescribed_ratios_are_those_of_the_clamped_modes() -> None:
    model = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.004, 0.006))), 4)
    assert model.damping_ratios == pytest.approx([0.004, 0.006, 0.006, 0.006])
    assert model.is_proportional
    assert np.all(model.free_hub_damping_ratios > model.damping_ratios)


def test_damping_adds_up() -> None:
    # zeta = xi/(2 rho omega) for distributed viscous, eta omega/2 for internal damping of a bare beam
    parameters = strip(damping=Damping(ratios=(0.001,), viscous=0.02, air=0.01, internal=1e-5))
    model = BeamModel(parameters, 4)
    omega = model.natural_frequencies
    expected = 0.001 + 0.03 / (2 * parameters.mass_per_length * omega) + 0.5e-5 * omega
    assert model.damping_ratios == pytest.approx(expected, rel=1e-10)


def test_coupled_damping_gives_the_poles_of_the_coupled_system() -> None:
    model = BeamModel(strip(tip_mass=5e-3, damping=Damping(viscous=0.3)), 4)
    assert not model.is_proportional
    C = model.matrices.C[1:, 1:] / model.basis.modal_mass
    for pole in model.poles:
        dynamic = pole**2 * np.eye(4) + pole * C + np.diag(model.basis.natural_frequencies**2)
        singular = np.linalg.svd(dynamic, compute_uv=False)
        assert singular[-1] < 1e-9 * singular[0]
    assert model.damping_ratios == pytest.approx(-model.poles.real / np.abs(model.poles))


OVERDAMPED = [
    Damping(ratios=(0.005,), internal=0.00135),
    Damping(ratios=(0.005,), viscous=10.0),
    Damping(ratios=(0.005,), air=20.0),
    Damping(ratios=(0.005,), air=20.0, internal=0.002),
]


@pytest.mark.parametrize("damping", OVERDAMPED, ids=str)
@pytest.mark.parametrize("changes", [{}, {"gravity": "upright", "tip_mass": 2e-3}], ids=["bare", "loaded"])
def test_modes_beyond_oscillation_keep_their_poles(damping: Damping, changes: dict[str, object]) -> None:
    model = BeamModel(strip(damping=damping, **changes), 5)
    C, K = model.matrices.C[1:, 1:] / model.basis.modal_mass, np.diag(model.basis.natural_frequencies**2)
    pairs = model.pole_pairs
    for pole in pairs.ravel():
        singular = np.linalg.svd(pole**2 * np.eye(5) + pole * C + K, compute_uv=False)
        assert singular[-1] < 1e-9 * singular[0]
    # The determinant at rest is the product of all poles: none is missing and none stands twice.
    assert np.prod(pairs) == pytest.approx(np.prod(model.basis.natural_frequencies**2), rel=1e-9)
    assert np.prod(model.natural_frequencies) == pytest.approx(np.prod(model.basis.natural_frequencies))
    assert model.damping_ratios.max() > 1.0
    free = model.free_hub_pole_pairs
    assert free.shape == (5, 2)
    assert np.all(free.real < 0.0)
    assert len(np.unique(free.round(6))) == 10
    assert np.all(np.diff(model.free_hub_natural_frequencies) > 0.0)


def test_a_pair_that_the_hub_tears_apart_is_put_together_again() -> None:
    """Under thick air the hub's own real pole and the slow one of mode 1 begin to swing together."""
    model = BeamModel(strip(damping=Damping(ratios=(0.005,), air=20.0, internal=0.002)), 5)
    assert model.damping_ratios[0] > 3.0
    slow, conjugate = model.free_hub_pole_pairs[0]
    assert slow.imag > 1.0
    assert conjugate == slow.conjugate()
    # Modes 4 and 5 do not oscillate; their slow poles lie above and below each other, the fast ones far out.
    assert model.free_hub_natural_frequencies[3:] == pytest.approx(model.natural_frequencies[3:], rel=2e-3)


@pytest.mark.parametrize(("hub_mass", "n_modes"), [(0.8, 5), (0.05, 5), (0.005, 10), (2e-4, 10)])
def test_the_number_of_modes_follows_from_the_error(hub_mass: float, n_modes: int) -> None:
    parameters = strip(hub_mass=hub_mass)
    model = BeamModel(parameters)
    assert model.n_modes == n_modes
    ratio = hub_mass / (parameters.mass_per_length * parameters.length)
    expected = free_hub_roots(5, ratio) ** 2 / parameters.time_scale
    assert model.free_hub_natural_frequencies[:5] == pytest.approx(expected, rel=1e-4)


def test_free_hub_poles_are_those_of_the_force_response() -> None:
    """With the left-out modes in it: near its pole the response is as large as the distance is small."""
    model = BeamModel(strip(hub_mass=0.005, damping=Damping(viscous=0.01)), 5)
    omega = model.free_hub_poles.imag
    found = np.abs(model.frequency_response(omega, [0.0], "force", "hub").values[:, 0])
    aside = np.abs(model.frequency_response(omega * 1.001, [0.0], "force", "hub").values[:, 0])
    decay = -model.free_hub_poles.real
    assert found / aside == pytest.approx(np.hypot(1.0, 0.001 * omega / decay), rel=0.05)


@pytest.mark.parametrize("changes", [{}, {"gravity": "upright"}, {"tip_mass": 3e-3, "clamp_stiffness": 20.0}])
def test_the_response_is_its_residues(changes: dict[str, object]) -> None:
    model = BeamModel(strip(damping=Damping(ratios=(0.005,)), **changes), 5)
    omega = TWO_PI * np.geomspace(0.1, 150.0, 60)
    s = 1j * omega[:, None]
    r, R = model.motion_residues(HEIGHTS), model.residual_terms(HEIGHTS)
    w = np.zeros((60, 3), dtype=complex)
    for mode in range(5):
        frequency, ratio = model.natural_frequencies[mode], model.damping_ratios[mode]
        w -= s**2 * r[:, mode] / (s**2 + 2 * ratio * frequency * s + frequency**2)
    w -= s**2 * R
    found = model.frequency_response(omega, HEIGHTS, quantity="deflection").values
    assert found == pytest.approx(w, rel=1e-10, abs=1e-14)
    total = model.frequency_response(omega, HEIGHTS).values
    assert total == pytest.approx(1.0 + w, rel=1e-10)


def test_the_static_correction_makes_a_short_model_right_at_low_frequency() -> None:
    rig = strip(gravity="upright", damping=Damping(ratios=(0.005,)))
    omega = TWO_PI * np.linspace(0.5, 45.0, 300)
    truth = BeamModel(rig, 40).frequency_response(omega, [0.010], quantity="deflection").values
    short = BeamModel(rig, 5)
    corrected = short.frequency_response(omega, [0.010], quantity="deflection").values
    bare = short.frequency_response(omega, [0.010], quantity="deflection", with_residuals=False).values
    assert np.median(np.abs(bare / truth - 1.0)) > 0.01
    assert np.median(np.abs(corrected / truth - 1.0)) < 5e-5


def test_under_force_the_clamped_frequencies_are_zeros_of_the_hub() -> None:
    model = BeamModel(strip(), 5)
    near = model.natural_frequencies[:3, None] * np.array([1.0 - 1e-7, 1.0 + 1e-7])
    hub = model.frequency_response(near.ravel(), [0.0], "force", "hub").values[:, 0].real.reshape(3, 2)
    assert np.all(np.sign(hub[:, 0]) != np.sign(hub[:, 1]))
    rigid = model.frequency_response([1e-3], [0.1], "force").values[0, 0]
    assert rigid * -(1e-3**2) * model.parameters.total_mass == pytest.approx(1.0, rel=1e-6)


def test_effective_masses_sum_to_the_beam() -> None:
    fractions = BeamModel(strip(gravity="upright", tip_mass=2e-3), 60).effective_mass_fractions
    # Effective masses fall off like 1/b^2; beyond 60 modes 4/(60 pi^2) of the beam's mass is left.
    assert np.sum(fractions) == pytest.approx(1.0, abs=4.0 / (60.0 * np.pi**2) * 1.2)
    assert np.sum(fractions) < 1.0


@pytest.mark.parametrize(("keyword", "value"), [("drive", "wind"), ("quantity", "colour")])
def test_an_unknown_drive_or_quantity_is_refused(keyword: str, value: str) -> None:
    with pytest.raises(BeamParameterError, match=value):
        BeamModel(strip(), 2).frequency_response([1.0], [0.1], **{keyword: value})  # type: ignore[arg-type]


def test_modal_parameters_meet_their_definitions() -> None:
    model = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.005,))), 5)
    modal = model.matrices.modal_parameters()
    assert modal.natural_frequencies[0] == 0.0
    assert modal.natural_frequencies[1:] == pytest.approx(model.free_hub_natural_frequencies, rel=1e-4)
    assert modal.masses == pytest.approx(np.ones(6))
    assert modal.stiffnesses == pytest.approx(modal.natural_frequencies**2, abs=1e-6)
    # C_r = 2 zeta_r omega_r M_r with C, where the source prints K.
    ratios = np.diag(modal.dampings)[1:] / (2.0 * modal.natural_frequencies[1:])
    assert ratios == pytest.approx(model.free_hub_damping_ratios, rel=1e-3)
    assert abs(modal.dampings[0, 0]) < 1e-12


@pytest.mark.parametrize(("drive", "unit"), [("motion", "m"), ("force", "N")])
def test_a_response_says_in_which_unit_its_input_is(drive: str, unit: str) -> None:
    response = BeamModel(strip(), n_modes=2).frequency_response(np.array([10.0]), HEIGHTS, drive=drive)
    assert response.input_unit == unit
