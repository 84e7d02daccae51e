"""An independent discretisation of the same energies: Hermite beam elements of scikit-fem."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh

from beam_model import BeamModel, BeamParameters, PointMass
from beam_model.parameters import STANDARD_GRAVITY
from tests.beam_model.rigs import strip

skfem = pytest.importorskip("skfem", reason="scikit-fem, a test dependency, is not installed")

MARKERS = (PointMass(0.225, 2e-4), PointMass(0.285, 1e-3))


def finite_element_frequencies(parameters: BeamParameters, hub_is_free: bool) -> np.ndarray:
    """Natural frequencies [rad/s] from 100 elements; a free hub adds its mass and keeps its slope."""
    from skfem.helpers import d, dd

    L, EI, rho = parameters.length, parameters.flexural_rigidity, parameters.mass_per_length
    heights = [mass.height for mass in parameters.point_masses]
    nodes = np.unique(np.round(np.concatenate([np.linspace(0.0, L, 101), heights]), 9))
    basis = skfem.Basis(skfem.MeshLine(nodes), skfem.ElementLineHermite(), intorder=8)

    def axial_load(z: np.ndarray) -> np.ndarray:
        load = rho * STANDARD_GRAVITY * (L - z) + parameters.tip_mass * STANDARD_GRAVITY
        for mass in parameters.point_masses:
            load = load + mass.mass * STANDARD_GRAVITY * (z < mass.height)
        return load

    stiffness = skfem.BilinearForm(
        lambda u, v, w: (
            EI * dd(u)[0, 0] * dd(v)[0, 0] - parameters.gravity_sign * axial_load(w.x[0]) * d(u)[0] * d(v)[0]
        )
    )
    K = stiffness.assemble(basis).toarray()
    M = skfem.BilinearForm(lambda u, v, _: rho * u * v).assemble(basis).toarray()
    deflection, slope = basis.nodal_dofs
    order = np.argsort(basis.mesh.p[0])
    deflection, slope = deflection[order], slope[order]
    for mass in parameters.point_masses:
        at = deflection[np.argmin(np.abs(nodes - mass.height))]
        M[at, at] += mass.mass
    M[deflection[-1], deflection[-1]] += parameters.tip_mass
    M[slope[-1], slope[-1]] += parameters.tip_inertia
    fixed = []
    if hub_is_free:
        M[deflection[0], deflection[0]] += parameters.hub_mass
    else:
        fixed.append(deflection[0])
    if np.isinf(parameters.clamp_stiffness):
        fixed.append(slope[0])
    else:
        K[slope[0], slope[0]] += parameters.clamp_stiffness
    kept = np.setdiff1d(np.arange(K.shape[0]), fixed)
    squared = eigh(K[np.ix_(kept, kept)], M[np.ix_(kept, kept)], eigvals_only=True)
    return np.sqrt(np.maximum(squared, 0.0))[1 if hub_is_free else 0 :]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"tip_mass": 3e-3, "tip_inertia": 1e-6},
        {"gravity": "upright"},
        {"gravity": "hanging", "tip_mass": 3e-3},
        {"gravity": "upright", "point_masses": MARKERS, "tip_mass": 1e-3, "clamp_stiffness": 30.0},
    ],
    ids=["bare", "tip", "upright", "hanging with tip", "everything"],
)
@pytest.mark.parametrize("hub_mass", [None, 0.8, 0.03], ids=["clamped", "free hub", "light free hub"])
def test_five_modes_agree_to_a_millionth(changes: dict[str, object], hub_mass: float | None) -> None:
    parameters = strip(**changes, **({} if hub_mass is None else {"hub_mass": hub_mass}))
    expected = finite_element_frequencies(parameters, hub_is_free=hub_mass is not None)[:5]
    if hub_mass is None:
        found = BeamModel(parameters, 5).natural_frequencies
    else:
        # Clamped modes as the basis of the free hub converge like n^-7.
        found = BeamModel(parameters, 20).free_hub_natural_frequencies[:5]
    assert found == pytest.approx(expected, rel=1e-6)
