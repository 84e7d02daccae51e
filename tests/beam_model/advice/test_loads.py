from __future__ import annotations

import numpy as np
import pytest

from beam_model import BeamModel, BeamParameterError, Damping
from beam_model.advice.loads import HeldLoads, LoadTrace, predict_loads
from tests.beam_model.rigs import strip

MODEL = BeamModel(strip(damping=Damping(ratios=(0.005,))), 5)
PERIOD, THICKNESS = 1e-3, 0.0005


def test_loads_at_resonance_are_those_of_the_reference() -> None:
    # 0.19 mm of hub at f1 gives a 30 mm tip at zeta 0.5 %; a 22 mm tip pulls with 0.20 N.
    period, f = 1e-3, MODEL.natural_frequencies[0] / (2.0 * np.pi)
    t = np.arange(60_000) * period
    a = 0.19e-3 * (2.0 * np.pi * f) ** 2 * np.sin(2.0 * np.pi * f * (t + period / 2))
    loads = predict_loads(MODEL, period, a, 0.0005)
    assert loads.tip_deflection == pytest.approx(0.030, rel=0.03)
    assert loads.modal_tip_deflections[0] == pytest.approx(0.030, rel=0.03)
    assert loads.modal_tip_deflections[1] < 1e-4
    # At resonance the beam's pull is a quarter period behind the rigid mass's.
    rigid = MODEL.parameters.total_mass * np.abs(a).max()
    assert loads.hub_force == pytest.approx(np.hypot(0.20 * 30.0 / 22.0, rigid), rel=0.03)
    # Mode 1: w''(0) = 3.516 w(L)/L^2
    assert loads.root_strain == pytest.approx(0.00025 * 3.516 * loads.tip_deflection / 0.09, rel=0.02)


@pytest.mark.parametrize(("values", "thickness"), [([], 0.001), ([np.nan], 0.001), ([1.0], 0.0)])
def test_bad_records_are_refused(values: list[float], thickness: float) -> None:
    with pytest.raises(BeamParameterError):
        predict_loads(MODEL, 1e-3, values, thickness)


@pytest.mark.parametrize("is_free", [False, True])
def test_a_record_in_pieces_loads_the_beam_as_the_whole_does(is_free: bool) -> None:
    drive = np.random.default_rng(1).standard_normal(2000)
    whole, pieces = (LoadTrace(MODEL, PERIOD, THICKNESS, is_free=is_free, position=0.01) for _ in range(2))
    whole.add(drive)
    for piece in np.split(drive, [1, 40, 1000]):
        pieces.add(piece)
    assert pieces.loads.tip_deflection == pytest.approx(whole.loads.tip_deflection, rel=1e-9)
    assert pieces.loads.root_strain == pytest.approx(whole.loads.root_strain, rel=1e-9)
    assert pieces.loads.hub_force == pytest.approx(whole.loads.hub_force, rel=1e-9)
    assert pieces.position == pytest.approx(whole.position, rel=1e-9)


def test_a_lasting_acceleration_bends_the_beam_as_its_weight_would() -> None:
    """mu a L^4/(8 E I) at the tip and mu a L^2/(2 E I) of curvature at the clamp, of an evenly loaded cantilever."""
    calm = BeamModel(strip(damping=Damping(ratios=(0.3,))), 5)
    p = calm.parameters
    held = HeldLoads(calm, PERIOD, THICKNESS)
    rest = held.after(np.zeros(held.n_states), 2.0, 20_000)
    tip, strain, force = held.peaks(rest, 2.0, 1)
    load = p.mass_per_length * 2.0 / p.flexural_rigidity
    assert tip == pytest.approx(load * p.length**4 / 8, rel=1e-6)
    assert strain == pytest.approx(THICKNESS / 2 * load * p.length**2 / 2, rel=1e-6)
    assert force == pytest.approx(p.total_mass * 2.0, rel=1e-6)


def test_a_lasting_force_on_a_free_hub_bends_the_beam_as_the_acceleration_of_all_masses_does() -> None:
    """Once at rest relative to the hub, everything moves with f/(hub and beam): the static curve of that weight."""
    calm = BeamModel(strip(damping=Damping(ratios=(0.3,))), 5)
    p, force = calm.parameters, 3.0
    held = HeldLoads(calm, PERIOD, THICKNESS, is_free=True)
    moving = held.after(np.zeros(held.n_states), force, 20_000)
    trace = LoadTrace(calm, PERIOD, THICKNESS, is_free=True, state=moving[held.elastic])
    trace.add([force])
    load = p.mass_per_length * force / p.total_mass / p.flexural_rigidity
    for tip, strain, pull in (
        held.peaks(moving, force, 1),
        (trace.loads.tip_deflection, trace.loads.root_strain, trace.loads.hub_force),
    ):
        assert tip == pytest.approx(load * p.length**4 / 8, rel=1e-6)
        assert strain == pytest.approx(THICKNESS / 2 * load * p.length**2 / 2, rel=1e-6)
        assert pull == pytest.approx(force, rel=1e-9)


def test_a_hold_overshoots_to_twice_its_lasting_deflection() -> None:
    slow = BeamModel(strip(damping=Damping(ratios=(1e-6,))), 1)
    p = slow.parameters
    held = HeldLoads(slow, PERIOD, THICKNESS)
    half = round(np.pi / slow.natural_frequencies[0] / PERIOD)
    lasting = p.mass_per_length * p.length**4 / (8 * p.flexural_rigidity)
    # One mode carries 99 % of the tip's static deflection, the rest follows without overshoot.
    assert held.peaks(np.zeros(2), 1.0, 2 * half)[0] == pytest.approx(2 * lasting, rel=0.03)
    assert held.peaks(np.zeros(2), 1.0, half // 3)[0] == pytest.approx(0.45 * lasting, rel=0.1)


@pytest.mark.parametrize("is_free", [False, True])
def test_holds_after_each_other_are_the_record_of_them(is_free: bool) -> None:
    held = HeldLoads(MODEL, PERIOD, THICKNESS, is_free=is_free)
    trace = LoadTrace(MODEL, PERIOD, THICKNESS, is_free=is_free)
    state, peaks = np.zeros(held.n_states), np.zeros(3)
    for n_ticks, drive in ((100, 1.0), (1, -3.0), (77, -2.0), (133, 0.5)):
        peaks = np.maximum(peaks, held.peaks(state, drive, n_ticks))
        state = held.after(state, drive, n_ticks)
        trace.add(np.full(n_ticks, drive))
    loads = trace.loads
    # The table is read at every other tick here.
    assert peaks == pytest.approx([loads.tip_deflection, loads.root_strain, loads.hub_force], rel=0.02)


def test_a_force_on_a_free_hub_gives_hub_and_beam_its_momentum() -> None:
    held = HeldLoads(MODEL, PERIOD, THICKNESS, is_free=True)
    state = held.after(np.zeros(held.n_states), 3.0, 250)
    rates = state[MODEL.n_modes + 1 :]
    assert MODEL.matrices.M[0] @ rates == pytest.approx(3.0 * 0.25, rel=1e-9)
