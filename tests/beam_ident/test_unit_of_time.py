"""What is measured on a bridge, a beam or a chip differs in its unit of time only: no limit is one of seconds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim

from beam_ident import (
    InputSignal,
    OutputSignal,
    Prior,
    TimeRecord,
    estimate_transfer_function,
    identify,
    subspace_model,
)

PERIOD = 0.005
N = 3000
MODES = ((2.3, 0.02, 1.0), (14.4, 0.01, -0.4))  # frequency [Hz], damping ratio, static share


def record(
    unit_s: float, structure: str, sigma: float = 0.0, lost: slice | None = None, late_s: float = 0.0
) -> TimeRecord:
    """Pass a sweep through two modes, in seconds as long as ``unit_s``."""
    rng = np.random.default_rng(3)
    t = PERIOD * np.arange(N)
    drive = np.sin(2 * np.pi * (0.5 * t + 29.5 * t**2 / (2 * t[-1])))
    output = np.zeros(N)
    for frequency, zeta, share in MODES:
        omega = 2 * np.pi * frequency
        numerator = [share, 0.0, 0.0] if structure == "base_motion" else [share * omega**2]
        output += lsim((numerator, [1.0, 2 * zeta * omega, omega**2]), drive, t)[1]
    output += 0.01 * np.std(output) * rng.standard_normal(N)
    stamps, measured = unit_s * t, drive + sigma * rng.standard_normal(N)
    keep = np.ones(N, dtype=bool)
    if lost is not None:
        keep[lost] = False
    unit = "m" if structure == "base_motion" else "N"
    return TimeRecord(
        (InputSignal("u", unit, stamps[keep], measured[keep], "linear", sigma=sigma),),
        (OutputSignal("y", "m", stamps + unit_s * late_s, output),),
    )


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("structure", "unit_s", "data", "options"),
    [
        ("receptance", 1e-6, {}, {}),
        ("receptance", 1e3, {}, {}),
        ("receptance", 1e-6, {}, {"latency": Prior(0.0, np.inf)}),
        ("receptance", 1e-6, {"late_s": 4.0}, {"latency": Prior(0.0, np.inf)}),
        ("base_motion", 1e-6, {"sigma": 1e-3}, {}),
        ("base_motion", 1e-6, {"lost": slice(900, 960)}, {}),
    ],
    ids=["chip", "bridge", "free", "late", "noisy", "gap"],
)
def test_modes_are_the_same_in_any_unit_of_time(structure, unit_s, data, options):
    # The limits of the latency are of seconds for long records, and shorter for short ones.
    expected, found = (
        identify(record(unit, structure, **data), structure, n_modes=2, **options) for unit in (1.0, unit_s)
    )
    np.testing.assert_allclose(found.model.poles * unit_s, expected.model.poles, rtol=1e-6)
    # What noise of the input feigns is drawn.
    np.testing.assert_allclose(
        found.model.damping_ratio_sd, expected.model.damping_ratio_sd, rtol=5e-3 if "sigma" in data else 1e-4
    )


@pytest.mark.parametrize("unit_s", [1e-6, 1e3])
def test_transfer_functions_and_subspaces_are_the_same_in_any_unit_of_time(unit_s):
    one, other = record(1.0, "receptance"), record(unit_s, "receptance")
    fits = [estimate_transfer_function(own, n_poles=4, n_zeros=2).model for own in (one, other)]
    np.testing.assert_allclose(np.sort(fits[1].poles) * unit_s, np.sort(fits[0].poles), rtol=1e-6)
    spaces = [np.sort(subspace_model(own, 4).poles) for own in (one, other)]
    np.testing.assert_allclose(spaces[1] * unit_s, spaces[0], rtol=1e-3)
