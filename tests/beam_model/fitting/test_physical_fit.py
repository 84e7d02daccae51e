from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameterError, BeamParameters, Damping, PointMass
from beam_model.errors import PhysicalFitError
from beam_model.fitting.physical_fit import ModalMeasurement, ParameterPrior, fit_beam, identifiability
from tests.beam_model.rigs import HEIGHTS, strip

HEIGHT_SIGMA = 0.0005
DISCREPANCY = 0.003
FREQUENCY_SIGMA, RATIO_SIGMA, RESIDUE_SIGMA = 1e-5, 0.01, 0.005
TRUTH = strip(
    gravity="upright",
    tip_mass=2e-3,
    clamp_stiffness=40.0,
    point_masses=(PointMass(0.225, 2e-4),),
    damping=Damping(viscous=0.02, internal=1e-5),
)
START = replace(
    TRUTH,
    flexural_rigidity=1.3 * TRUTH.flexural_rigidity,
    damping=Damping(viscous=1.3 * 0.02, internal=1.3e-5),
    tip_mass=1.3 * TRUTH.tip_mass,
    clamp_stiffness=TRUTH.clamp_stiffness / 1.3,
)
TRUE_VALUES = {
    "stiffness": TRUTH.time_scale**-2,
    "viscous": 0.02,
    "internal": 1e-5,
    "tip_mass": 2e-3,
    "clamp_compliance": 1 / 40.0,
}
PRIORS = {"tip_mass": ParameterPrior(2e-3, 2e-4), "clamp_compliance": ParameterPrior(0.025, 0.005)}


def measure(
    rng: np.random.Generator | None, n_modes: int = 3, *, with_residues: bool = False
) -> ModalMeasurement:
    """What an identification of TRUTH would report; without noise for rng None."""
    model = BeamModel(TRUTH, n_modes)
    omega, zeta = (
        model.basis.natural_frequencies,
        np.diag(model.matrices.C)[1:] / (2 * model.basis.modal_mass),
    )
    zeta = zeta / omega
    heights = np.array(HEIGHTS)
    residues = model.motion_residues(heights)
    sigma_r = RESIDUE_SIGMA * np.abs(residues).max(axis=0) * np.ones_like(residues)
    covariance = np.diag(np.concatenate([(FREQUENCY_SIGMA * omega) ** 2, (RATIO_SIGMA * zeta) ** 2]))
    if rng is not None:
        scatter = np.hypot(DISCREPANCY, FREQUENCY_SIGMA)
        omega = omega * (1.0 + scatter * rng.standard_normal(n_modes))
        zeta = zeta * (1.0 + RATIO_SIGMA * rng.standard_normal(n_modes))
        residues = model.motion_residues(heights + HEIGHT_SIGMA * rng.standard_normal(3))
        residues = residues + sigma_r * rng.standard_normal(residues.shape)
    if not with_residues:
        return ModalMeasurement.from_arrays(omega, zeta, covariance)
    return ModalMeasurement.from_arrays(
        omega, zeta, covariance, heights, residues, np.diag(sigma_r.ravel() ** 2)
    )


def start(free: tuple[str, ...]) -> BeamParameters:
    """30 % off in everything free, true in the rest."""
    changes = {}
    if "tip_mass" not in free:
        changes["tip_mass"] = TRUTH.tip_mass
    if "clamp_compliance" not in free:
        changes["clamp_stiffness"] = TRUTH.clamp_stiffness
    return replace(START, **changes)  # type: ignore[arg-type]


CASES = [
    (("stiffness",), False),
    (("stiffness", "viscous", "internal"), False),
    (("stiffness", "viscous", "internal", "tip_mass"), True),
    (("stiffness", "tip_mass", "clamp_compliance"), True),
]


@pytest.mark.parametrize(("free", "with_residues"), CASES)
def test_without_noise_the_truth_is_found_from_thirty_percent_off(
    free: tuple[str, ...], with_residues: bool
) -> None:
    fit = fit_beam(
        measure(None, with_residues=with_residues),
        start(free),
        free,
        {name: prior for name, prior in PRIORS.items() if name in free},
        height_uncertainty=HEIGHT_SIGMA,
    )
    expected = np.array([TRUE_VALUES[name] for name in free])
    assert fit.values == pytest.approx(expected, rel=1e-5)
    assert fit.chi_squared < 1e-6
    assert np.abs(fit.frequency_residuals).max() < 1e-6
    assert fit.parameters.flexural_rigidity == pytest.approx(TRUTH.flexural_rigidity, rel=1e-5)


def coverage(free: tuple[str, ...], with_residues: bool, n_draws: int) -> tuple[np.ndarray, np.ndarray]:
    """Share of draws with the truth inside 95 %, and the number beyond 3 sd, per parameter."""
    rng = np.random.default_rng(20)
    scores = []
    for _ in range(n_draws):
        # Priors are draws, too: what is believed of the tip mass scatters about the truth.
        priors = {
            name: ParameterPrior(
                prior.mean + prior.standard_deviation * rng.standard_normal(), prior.standard_deviation
            )
            for name, prior in PRIORS.items()
            if name in free
        }
        fit = fit_beam(
            measure(rng, with_residues=with_residues),
            start(free),
            free,
            priors,
            height_uncertainty=HEIGHT_SIGMA,
            model_discrepancy=DISCREPANCY,
            damping_discrepancy=0.0,
        )
        expected = np.array([TRUE_VALUES[name] for name in free])
        scores.append((fit.values - expected) / fit.standard_deviations)
    z = np.abs(np.array(scores))
    return np.mean(z < 1.96, axis=0), np.sum(z > 3.0, axis=0)


@pytest.mark.slow
def test_intervals_cover_the_truth() -> None:
    inside, beyond = coverage(("stiffness", "viscous", "internal"), False, 30)
    # 30 draws at 95 %: below 0.8, or above 2 beyond 3 sd, less than once in a thousand.
    assert np.all(inside >= 0.8)
    assert np.all(beyond <= 2)


@pytest.mark.verify
@pytest.mark.parametrize(("free", "with_residues"), CASES[1:])
def test_intervals_cover_the_truth_over_a_thousand_draws(free: tuple[str, ...], with_residues: bool) -> None:
    inside, beyond = coverage(free, with_residues, 1000)
    assert np.all((inside >= 0.92) & (inside <= 0.98))
    assert np.all(beyond <= 10)


def test_frequencies_alone_never_tell_tip_mass_or_clamp() -> None:
    for name in ("tip_mass", "clamp_compliance"):
        with pytest.raises(PhysicalFitError, match="residues"):
            fit_beam(measure(None), TRUTH, ("stiffness", name), PRIORS)


def test_residues_need_priors_and_height_uncertainties() -> None:
    data = measure(None, with_residues=True)
    with pytest.raises(PhysicalFitError, match="prior"):
        fit_beam(data, TRUTH, ("stiffness", "tip_mass"), height_uncertainty=HEIGHT_SIGMA)
    with pytest.raises(PhysicalFitError, match="height_uncertainty"):
        fit_beam(data, TRUTH, ("stiffness",))


def test_what_cannot_be_told_apart_is_refused_with_its_singular_values() -> None:
    # One mode cannot tell viscous from internal damping.
    with pytest.raises(PhysicalFitError, match=r"(?s)viscous and internal apart.*singular values"):
        fit_beam(
            measure(None, 1),
            START,
            ("stiffness", "viscous", "internal"),
            {"stiffness": ParameterPrior(65.5, 1.0)},
        )
    # Three can; not under a stricter limit.
    with pytest.raises(PhysicalFitError, match="condition"):
        fit_beam(measure(None), START, ("stiffness", "viscous", "internal"), max_condition=1.05)


def test_a_weak_prior_is_reported_as_inflation() -> None:
    fit = fit_beam(
        measure(None, with_residues=True),
        start(("tip_mass", "clamp_compliance")),
        ("stiffness", "tip_mass", "clamp_compliance"),
        PRIORS,
        height_uncertainty=HEIGHT_SIGMA,
    )
    assert fit.singular_values[0] / fit.singular_values[-1] == pytest.approx(fit.condition)
    assert fit.inflations[0] > 1.5
    assert np.all(fit.inflations >= 1.0 - 1e-9)
    alone = fit_beam(measure(None), start(()), ("stiffness",))
    assert alone.inflations == pytest.approx([1.0])
    assert alone.condition == pytest.approx(1.0)


def test_a_model_discrepancy_keeps_the_fit_honest() -> None:
    tight = fit_beam(measure(None), start(()), ("stiffness",), model_discrepancy=0.0)
    honest = fit_beam(measure(None), start(()), ("stiffness",))
    # kappa ~ omega^2: 2 x 0.3 % over sqrt(3) modes, against 2 x 1e-5.
    assert honest.standard_deviations[0] / honest.values[0] == pytest.approx(2 * 0.003 / np.sqrt(3), rel=0.05)
    assert honest.standard_deviations[0] > 200 * tight.standard_deviations[0]


def test_the_identifiability_table_is_the_documented_one() -> None:
    rig = strip()
    lost = float("inf")
    assert identifiability(rig, ("tip_mass", "clamp_compliance")).condition == lost
    assert identifiability(rig, ("flexural_rigidity", "mass_per_length")).condition == lost
    assert identifiability(rig, ("flexural_rigidity", "mass_per_length"), heights=HEIGHTS).condition == lost
    assert identifiability(rig, ("flexural_rigidity", "tip_mass")).inflations.max() > 10.0
    assert identifiability(rig, ("flexural_rigidity", "tip_mass"), heights=HEIGHTS).inflations.max() < 2.0
    assert identifiability(rig, ("flexural_rigidity", "length"), heights=HEIGHTS).inflations.max() < 2.0
    by_force = identifiability(rig, ("flexural_rigidity", "mass_per_length", "hub_mass"), "force", HEIGHTS)
    assert by_force.condition < 100.0
    with pytest.raises(BeamParameterError, match="names"):
        identifiability(rig, ("colour",))
    with pytest.raises(BeamParameterError, match="drive"):
        identifiability(rig, ("length",), "wind")


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (([2.0, 1.0], [0.1, 0.1], np.eye(4)), "frequencies"),
        (([1.0, 2.0], [0.1], np.eye(4)), "damping_ratios"),
        (([1.0, 2.0], [0.1, 0.1], np.eye(3)), "covariance"),
        (([1.0, 2.0], [0.1, 0.1], -np.eye(4)), "covariance"),
        (([1.0, 2.0], [0.1, 0.1], np.eye(4), [0.1]), "residues"),
        (([1.0, 2.0], [0.1, 0.1], np.eye(4), [0.1], np.ones((2, 2)), np.eye(2)), "residues"),
    ],
)
def test_bad_measurements_are_refused(arguments: tuple[object, ...], name: str) -> None:
    with pytest.raises(BeamParameterError, match=name):
        ModalMeasurement.from_arrays(*arguments)  # type: ignore[arg-type]


def test_unknown_parameters_and_bad_settings_are_refused() -> None:
    with pytest.raises(BeamParameterError, match="free"):
        fit_beam(measure(None), TRUTH, ("colour",))
    with pytest.raises(BeamParameterError, match="free"):
        fit_beam(measure(None), TRUTH, ())
    with pytest.raises(BeamParameterError, match="model_discrepancy"):
        fit_beam(measure(None), TRUTH, model_discrepancy=-1.0)
    with pytest.raises(BeamParameterError, match="standard_deviation"):
        ParameterPrior(1.0, 0.0)


def test_condition_and_inflation_of_two_parameters_belong_to_one_angle() -> None:
    table = identifiability(strip(), ("length", "clamp_compliance"), heights=HEIGHTS)
    condition = table.singular_values[0] / table.singular_values[1]
    assert table.condition == pytest.approx(condition, rel=1e-12)
    # Unit columns with the cosine c: condition^2 = (1 + c)/(1 - c), and both deviations grow by 1/sqrt(1 - c^2).
    assert table.inflations == pytest.approx(np.full(2, 0.5 * (condition + 1.0 / condition)), rel=1e-9)


def test_a_prior_and_a_frequency_are_weighed_by_their_variances() -> None:
    # A bare clamped beam: omega_1 = 1.8751041^2 sqrt(kappa). Two opinions of kappa, a thousandth apart.
    bare = strip()
    kappa = bare.time_scale**-2
    omega = 1.8751040687**2 * np.sqrt(kappa)
    covariance = np.diag([(5e-4 * omega) ** 2, 1.0])  # kappa to a thousandth of itself
    seen = ModalMeasurement.from_arrays([omega], [0.005], covariance)
    prior = ParameterPrior(1.001 * kappa, 5e-4 * kappa)
    fit = fit_beam(seen, bare, ("stiffness",), {"stiffness": prior}, model_discrepancy=0.0)
    weights = np.array([1.0 / 1e-3**2, 1.0 / 5e-4**2])
    assert fit.values[0] / kappa - 1.0 == pytest.approx(1e-3 * weights[1] / weights.sum(), rel=1e-2)
    assert fit.standard_deviations[0] / kappa == pytest.approx(weights.sum() ** -0.5, rel=1e-2)
