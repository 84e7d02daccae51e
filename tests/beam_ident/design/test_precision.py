"""Precision that is predicted before a fit, against the standard deviations that the fit states."""

from __future__ import annotations

import numpy as np

from beam_ident import InputSignal, OutputSignal, TimeRecord, identify
from beam_ident.design.precision import predicted_precision
from tests.beam_ros.signals.foreign_bags import DAMPING_RATIOS, FREQUENCIES_HZ, shaken

NOISE = 5e-6


def record(duration_s: float) -> TimeRecord:
    beam = shaken(duration_s, 4)
    noise = NOISE * np.random.default_rng(5).standard_normal(len(beam.times_s[::10]))
    drive = InputSignal("hub", "m", beam.times_s, beam.base, "cubic")
    seen = OutputSignal("tip", "m", beam.times_s[::10], beam.displacement[::10] + noise)
    return TimeRecord((drive,), (seen,))


def test_the_prediction_is_what_the_fit_states() -> None:
    own = record(5.0)
    # Poles a part in a thousand off, as theory may be.
    omegas, zetas = 2.0 * np.pi * FREQUENCIES_HZ * 1.0003, DAMPING_RATIOS * 1.05
    predicted = predicted_precision([own], "base_motion", omegas, zetas, {"tip": NOISE}, 50e-6)
    model = identify(own, n_modes=2).model
    # The fit's noise is that of one record, and its poles are not those that were assumed.
    np.testing.assert_allclose(predicted.omega_sd, model.natural_frequency_sd, rtol=0.25)
    np.testing.assert_allclose(predicted.zeta_sd, model.damping_ratio_sd, rtol=0.25)


def test_twice_the_noise_is_half_the_precision_and_a_mode_beyond_the_excitation_is_unknown() -> None:
    own = record(3.0)
    omegas = 2.0 * np.pi * FREQUENCIES_HZ
    one, two = (
        predicted_precision([own], "base_motion", omegas, DAMPING_RATIOS, {"tip": k * NOISE}) for k in (1, 2)
    )
    np.testing.assert_allclose(two.omega_sd, 2.0 * one.omega_sd)
    # Above the excitation nothing is seen of a mode that is not there: its damping is known to no digit.
    three = [np.append(omegas, 2.0 * np.pi * 140.0), np.append(DAMPING_RATIOS, 0.005)]
    beyond = predicted_precision([own], "base_motion", *three, {"tip": NOISE})
    assert not beyond.zeta_sd[2] < 0.5 * 0.005
    assert beyond.zeta_sd[0] < 0.01 * DAMPING_RATIOS[0]
