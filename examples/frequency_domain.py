"""The frequency domain: averaged periods, a look for distortion, models fitted to lines."""

import numpy as np
from simulated_beam import TRUTH, film

from beam_ident import (
    Multisine,
    fit_frequency_modes,
    fit_frequency_transfer_function,
    nonlinear_distortion,
    periodic_response,
)

# Twelve periods of 10 s on odd lines; one of every four is left out, so that distortion would show there.
recipe = Multisine(
    start_frequency=0.5,
    end_frequency=40.0,
    line_period=10.0,
    n_periods=12,
    lines="random_odd",
    detection_group=4,
    seed=3,
)
record = film(1, recipe)

# The first periods go, in which the response settles, and the end, where the signal fades; a drift of 1 says so.
found = periodic_response(record, 10.0, recipe.lines_hz, start_s=79.0, end_s=119.0)
print(f"{found.n_periods} periods, {found.response.n_lines} lines, drift {np.max(found.drift):.2f}")
print(nonlinear_distortion(found).verdict)

# Every line weighs by its own noise; the misfit says whether noise alone is left.
result = fit_frequency_modes(found.response, "base_motion")
model = result.model
for k, f_true in enumerate(TRUTH.frequencies_hz):
    f, f_sd = model.frequencies_hz[k], model.natural_frequency_sd[k] / (2 * np.pi)
    zeta, zeta_sd = 100 * model.damping_ratios[k], 100 * model.damping_ratio_sd[k]
    print(f"  {f:.6f} +- {f_sd:.6f} Hz, off by {(f - f_true) / f_sd:+.1f} sd; {zeta:.4f} +- {zeta_sd:.4f} %")
print(f"misfit {result.misfit.chi_squared:.0f} of {result.misfit.expected:.0f} expected")

# B(s)/A(s) of the tip alone, from the same lines.
tip = periodic_response(record.select(["tip"]), 10.0, recipe.lines_hz, start_s=79.0, end_s=119.0).response
omega, _, omega_sd, _ = fit_frequency_transfer_function(tip, 4, 4).model.modes()
for w, sd in zip(omega, omega_sd, strict=True):
    print(f"  transfer function: {w / (2 * np.pi):.6f} +- {sd / (2 * np.pi):.6f} Hz")
