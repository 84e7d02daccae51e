"""Outputs with clocks of their own, beside a latency and a rate that all share."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping

import numpy as np
import pytest

from beam_ident import (
    EstimationError,
    InputSignal,
    ModalModel,
    OutputSignal,
    Prior,
    TimeRecord,
    identify,
    linearity,
    validate,
)
from benchmarks.ident.forced_beam import PLAIN, ForcedBeam
from tests.beam_ident.truth import OMEGAS, ZETAS, beam_record


def late(seed: int, delays: Mapping[str, float], rates: Mapping[str, float] | None = None) -> TimeRecord:
    """Return a record in which the stamps of some outputs are late, or come from a clock that runs fast."""
    record = beam_record(seed)
    middle = 0.5 * (record.outputs[0].times_s[0] + record.outputs[0].times_s[-1])
    outputs = []
    for own in record.outputs:
        fast = middle + (own.times_s - middle) * (1.0 + (rates or {}).get(own.name, 0.0))
        outputs.append(dataclasses.replace(own, times_s=fast + delays.get(own.name, 0.0)))
    return TimeRecord(record.inputs, tuple(outputs))


@pytest.mark.slow
@pytest.mark.parametrize("delay", [30e-6, -20e-3, 80e-3, -1.2])
def test_a_delay_of_one_output_is_found_and_costs_nothing(delay: float) -> None:
    model = identify(late(1, {"z225": delay})).model
    assert model.n_modes == 3
    assert abs(model.output_delays[1] - delay) < 4.0 * model.output_delay_sd[1]
    assert 0.0 < model.output_delay_sd[1] < 5e-6
    np.testing.assert_array_equal(model.output_delays[[0, 2]], 0.0)
    z = np.concatenate(
        [
            (model.natural_frequencies - OMEGAS) / model.natural_frequency_sd,
            (model.damping_ratios - ZETAS) / model.damping_ratio_sd,
        ]
    )
    assert np.max(np.abs(z)) < 4.0
    stored = ModalModel.from_dict(json.loads(json.dumps(model.to_dict())))
    np.testing.assert_array_equal(stored.output_delays, model.output_delays)
    unseen = validate(stored, late(5, {"z225": delay})).outputs
    assert min(own.scores.fit_percent for own in unseen) > 99.5


@pytest.mark.slow
def test_a_rate_of_one_output_is_found_beside_its_delay() -> None:
    record = late(1, {"z225": 3e-3}, {"z225": 6e-5})
    found = identify(record)
    model = found.model
    assert model.n_modes == 3
    assert abs(model.output_delays[1] - 3e-3) < 4.0 * model.output_delay_sd[1] < 1e-5
    assert abs(model.output_rates[1] - 6e-5) < 4.0 * model.output_rate_sd[1] < 4e-6
    np.testing.assert_array_equal(model.output_rates[[0, 2]], 0.0)
    assert np.max(np.abs((model.natural_frequencies - OMEGAS) / model.natural_frequency_sd)) < 4.0
    assert any("z225 runs +6" in said for said in found.warnings)
    stored = ModalModel.from_dict(json.loads(json.dumps(model.to_dict())))
    assert stored.own_clocks == model.own_clocks
    unseen = validate(stored, late(5, {"z225": 3e-3}, {"z225": 6e-5})).outputs
    assert min(own.scores.fit_percent for own in unseen) > 99.5


@pytest.mark.slow
def test_what_is_known_of_single_clocks_is_taken_as_it_is() -> None:
    # Camera 2 ms late, which nobody knows; the laser known to be 5 ms late, or known to 1 us.
    record = late(2, {"z010": 2e-3, "z225": 5e-3, "z285": 2e-3})
    sure = identify(record, latency={"z225": 5e-3}, n_modes=3).model
    assert abs(sure.latency - 2e-3) < 4.0 * sure.latency_sd
    assert sure.latency + sure.output_delays[1] == pytest.approx(5e-3, abs=1e-8)
    free = identify(record, n_modes=3).model
    nearly = identify(record, latency={"z225": Prior(5e-3, 1e-6)}, n_modes=3).model
    for own in (free, nearly):
        assert abs(own.latency + own.output_delays[1] - 5e-3) < 1e-5
    # Poles in common tie the phases of both: what is known of one sensor tells of the other, too.
    assert nearly.latency_sd < 0.5 * free.latency_sd
    known = identify(record, latency={"z010": 2e-3, "z225": 5e-3, "z285": 2e-3}, n_modes=3).model
    assert known.latency == 0.0
    np.testing.assert_allclose(known.output_delays, [2e-3, 5e-3, 2e-3], atol=1e-8)
    for own in (sure, nearly, known):
        assert np.max(np.abs((own.natural_frequencies - OMEGAS) / own.natural_frequency_sd)) < 4.0


@pytest.mark.parametrize(
    ("latency", "said"),
    [
        ({"z999": 0.0}, "latency names 'z999'.*z010, z225, z285"),
        ({"z225": "late"}, "latency of z225 is 'late'; expected a number or a Prior"),
        (2e-3, "a mapping from names of outputs"),
    ],
)
def test_an_unfit_latency_is_refused(latency, said) -> None:
    with pytest.raises(EstimationError, match=said):
        identify(beam_record(1), latency=latency)


@pytest.mark.slow
def test_modes_are_not_added_for_a_delay_of_one_output() -> None:
    # With one clock for both, eight modes follow each other before a ninth is refused.
    looked_for = []
    beam = ForcedBeam()
    stamps = beam.period * np.arange(10, beam.n - 10)
    record = beam.record(0, 20.0, stamps + 7.3e-3, stamps)
    first, second = record.outputs
    second = dataclasses.replace(second, times_s=second.times_s + 3e-3)
    clocks = Prior(0.0, np.inf), Prior()
    found = identify(
        TimeRecord(record.inputs, (first, second)),
        PLAIN,
        None,
        *clocks,
        progress=lambda phrase, share: looked_for.append(phrase),
    )
    assert found.model.n_modes == 3
    assert "looking for mode 5" not in looked_for
    own = found.model.output_delays[1] - found.model.output_delays[0]
    assert abs(own - 3e-3) < 4.0 * float(np.linalg.norm(found.model.output_delay_sd)) < 1e-4


@pytest.mark.slow
def test_outputs_that_share_a_clock_have_no_delays() -> None:
    # One record in a thousand.
    for seed in range(4):
        found = identify(beam_record(seed, latency=2e-3), n_modes=3)
        np.testing.assert_array_equal(found.model.output_delays, 0.0)
        assert not any("stamps of" in said for said in found.warnings)


@pytest.mark.slow
def test_a_file_of_an_earlier_version_has_no_delays() -> None:
    stored = identify(beam_record(1), n_modes=3).model.to_dict()
    for name in ("output_delays_s", "output_delay_sd_s", "output_rates", "output_rate_sd"):
        del stored[name]
    np.testing.assert_array_equal(ModalModel.from_dict(stored).output_delays, np.zeros(3))


def strip_in_air(drag: float = 2.0, noise: float = 1e-6) -> TimeRecord:
    """Return three points of a mode whose damping grows with its speed, which one pole does not describe.

    Parameters
    ----------
    drag : float -- 1/m
    noise : float -- of the encoder [m]
    """
    rng, t = np.random.default_rng(1), np.arange(0.0, 20.0, 1e-3)
    hub, omega = np.zeros(len(t)), 2.0 * np.pi * 4.4
    for begin, distance in ((1.0, 0.02), (1.5, -0.02)):
        share = np.clip((t - begin) / 0.2, 0.0, 1.0)
        hub += distance * (10.0 * share**3 - 15.0 * share**4 + 6.0 * share**5)
    push = -1.5 * np.gradient(np.gradient(hub, t), t)
    swing, speed, step = np.zeros(len(t)), 0.0, 1e-3
    for k in range(1, len(t)):  # leapfrog; its own error of the frequency is nobody's concern here
        force = push[k - 1] - omega**2 * swing[k - 1] - (0.01 * omega + drag * abs(speed)) * speed
        speed += step * force
        swing[k] = swing[k - 1] + step * speed
    frames = np.arange(5, len(t) - 40, 10)
    seen_at = t[frames] + 3e-4 * rng.standard_normal(len(frames))
    encoder = hub + noise * rng.standard_normal(len(t))
    outputs = [
        OutputSignal(name, "m", t[frames], np.interp(seen_at, t, hub + shape * swing) + own)
        for name, shape, own in zip(
            ("root", "middle", "tip"),
            (0.004, 0.8, 1.0),
            5e-6 * rng.standard_normal((3, len(frames))),
            strict=True,
        )
    ]
    return TimeRecord((InputSignal("hub", "m", (0.0, 1e-3), encoder, "linear", sigma=noise),), tuple(outputs))


@pytest.mark.slow
def test_a_clock_that_was_left_out_is_not_looked_for_twice() -> None:
    weighed = []

    def told(stage: str, _share: float) -> None:
        weighed.append(stage.startswith("weighing"))

    found = identify(strip_in_air(), n_modes=1, progress=told)
    assert found.model.output_delays[0] != 0.0  # what the pole does not explain
    assert 2 < sum(weighed) < 7, sum(weighed)


@pytest.mark.slow
@pytest.mark.parametrize(("drag", "noise"), [(2.0, 1e-6), pytest.param(8.0, 3e-8, marks=pytest.mark.verify)])
def test_what_a_curve_leaves_is_no_crowd_of_modes_and_no_clock(drag: float, noise: float) -> None:
    record = strip_in_air(drag, noise)
    found = identify(record)  # an error, or up to six modes that overlap, where poles were added to the last
    assert found.model.n_modes < 3
    assert np.max(np.abs(found.model.natural_frequencies / (2.0 * np.pi * 4.4) - 1.0)) < 0.01
    assert not linearity([record], found.model).is_linear
