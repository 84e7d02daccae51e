"""Sader's theory of still air against the flow itself, solved along the blade."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import kv

from beam_model import BeamModel, BeamParameterError, StillAir, exact_frequency_response
from beam_model.continuum.still_air import air_load, hydrodynamic_function
from tests.beam_model.rigs import strip


def flow_around_a_blade(reynolds: float, n: int = 80) -> complex:
    """Gamma from unsteady Stokes flow in two dimensions: forces along the blade that move all of it alike.

    Forces f(x) along a blade of half width 1 give its fluid the velocity int A(R |x - x'|) f(x') dx' / (4 pi mu),
    A(r) = 2 [K_0(r) + K_1(r)/r - 1/r^2] and R^2 = -i omega rho/mu (Pozrikidis 1992), which is -i Re. With x = cos t
    they are f = sum c_k cos(2 k t)/sin t, and A = -log|x - x'| + what the midpoint rule integrates.
    """
    R = np.sqrt(-1j * reynolds)
    m = 4 * n
    t = (np.arange(m) + 0.5) * np.pi / m
    at = (np.arange(n) + 0.5) * np.pi / (2 * n)  # one half, by symmetry
    distance = np.abs(np.cos(at)[:, None] - np.cos(t)[None, :])
    r = R * np.maximum(distance, 1e-3 / abs(R))
    smooth = 2.0 * (kv(0, r) + kv(1, r) / r - 1.0 / r**2) + np.log(np.abs(r / R))
    k = np.arange(n)
    # int_0^pi log|x - cos t| cos(2kt) dt = -pi T_2k(x)/(2k), and -pi log 2 for k = 0.
    logs = np.pi * np.cos(2 * k[None, :] * at[:, None]) / np.maximum(2 * k[None, :], 1)
    logs[:, 0] = np.pi * np.log(2.0)
    system = smooth @ np.cos(2 * t[:, None] * k[None, :]) * (np.pi / m) + logs
    c = np.linalg.solve(system, np.ones(n))
    # At velocity 1 the blade bears -4 pi^2 mu c_0: pi/4 rho omega^2 b^2 Gamma times its displacement i/omega.
    return complex(4.0j * np.pi * c[0] / reynolds)


@pytest.mark.parametrize("reynolds", [0.01, 1.0, 10.0, 100.0, 300.0])
def test_the_function_is_that_of_the_flow(reynolds: float) -> None:
    found = complex(hydrodynamic_function(reynolds)[0])
    # Sader's fit is good to 0.1 %.
    assert abs(found - flow_around_a_blade(reynolds)) < 1e-3 * abs(found)


def test_beyond_its_range_the_function_stays_finite() -> None:
    ends = hydrodynamic_function([0.0, 1e-9, 1e4, 1e7])
    assert np.all(np.isfinite(ends))
    assert ends[3].real == pytest.approx(1.0, abs=0.03)  # all that potential flow around a plate drags along
    assert 0.0 < ends[3].imag < ends[2].imag


def test_air_is_dry_air() -> None:
    # US Standard Atmosphere 1976, at sea level: 288.15 K.
    air = StillAir(temperature=288.15, pressure=101325.0)
    assert air.density == pytest.approx(1.2250, rel=1e-4)
    assert air.viscosity == pytest.approx(1.7894e-5, rel=1e-4)


@pytest.mark.parametrize("thickness", [5e-4, 5e-5])
def test_modes_carry_the_air_of_their_own_frequencies(thickness: float) -> None:
    changes = {"clamp_stiffness": 5.0, "tip_mass": 0.01 * thickness}
    dry, wet = strip(thickness=thickness, **changes), strip(thickness=thickness, air=StillAir(), **changes)
    model, without = BeamModel(wet, 8), BeamModel(dry, 8)
    load = air_load(wet, model.natural_frequencies)
    share = load.mass * np.diag(without.basis.strip_overlap) / dry.beam_mass
    expected = without.natural_frequencies / np.sqrt(1.0 + share)
    assert model.natural_frequencies == pytest.approx(expected, rel=2e-4)
    ratios = load.damping * np.diag(without.basis.strip_overlap) / dry.beam_mass
    ratios = ratios / (1.0 + share) / (2.0 * expected)
    assert model.damping_ratios == pytest.approx(ratios, rel=2e-3)
    # All that is accelerated is carried by some mode, the air included.
    assert np.sum(BeamModel(wet, 60).effective_mass_fractions) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("drive", ["motion", "force"])
def test_resonances_in_air_are_those_of_the_closed_form(drive: str) -> None:
    """The closed form takes the air of every frequency, the modes that of their own."""
    parameters = strip(air=StillAir(), thickness=2e-4, hub_mass=0.05)
    model = BeamModel(parameters, 10)
    frequencies = model.natural_frequencies if drive == "motion" else model.free_hub_natural_frequencies
    for omega in frequencies[:3]:
        near = omega * np.linspace(0.99, 1.01, 81)
        exact = exact_frequency_response(parameters, near, (0.285,), drive).values[:, 0]
        found = model.frequency_response(near, (0.285,), drive).values[:, 0]
        # A free hub's modes swing faster than the clamped ones, by whose air they are described.
        assert np.abs(found - exact).max() < (0.02 if drive == "motion" else 0.06) * np.abs(exact).max()
        assert np.argmax(np.abs(found)) == pytest.approx(np.argmax(np.abs(exact)), abs=1)


def test_air_needs_a_section() -> None:
    bare = strip(air=StillAir()).__dict__ | {"section": None}
    with pytest.raises(BeamParameterError, match=r"section.*from_section"):
        type(strip())(**bare)
    with pytest.raises(BeamParameterError, match=r"293\.15 K"):
        StillAir(temperature=20.0)
