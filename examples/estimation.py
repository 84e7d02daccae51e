"""Estimation: modes with common poles from all points, without hints; a transfer function beside it."""

import numpy as np
from simulated_beam import TRUTH, film

from beam_ident import Prior, estimate_transfer_function, identify

record = film(1)
result = identify(record)
model = result.model
print(f"{model.n_modes} modes, {result.reason}")
for k in range(model.n_modes):
    f, f_sd = model.frequencies_hz[k], model.natural_frequency_sd[k] / (2 * np.pi)
    zeta, zeta_sd = model.damping_ratios[k], model.damping_ratio_sd[k]
    off = (f - TRUTH.frequencies_hz[k]) / f_sd, (zeta - TRUTH.damping_ratios[k]) / zeta_sd
    print(f"  {f:.6f} +- {f_sd:.6f} Hz, {100 * zeta:.4f} +- {100 * zeta_sd:.4f} %", end="")
    print(f"   off by {off[0]:+.1f} and {off[1]:+.1f} standard deviations")
print(f"camera {1e6 * model.latency:+.1f} +- {1e6 * model.latency_sd:.1f} us late")

# A clock that is known makes the frequencies better known.
sharp = identify(record, latency=Prior(0.0), clock_rate=Prior(0.0), n_modes=2).model
print(f"with a known clock: +- {sharp.natural_frequency_sd[0] / (2 * np.pi):.6f} Hz on mode 1")

# B(s)/A(s) from hub to tip alone, with the clock taken as exact: the same poles.
found = estimate_transfer_function(record.select(["tip"]), n_poles=4, n_zeros=4)
omega, _, omega_sd, _ = found.model.modes()
for w, sd in zip(omega, omega_sd, strict=True):
    print(f"  transfer function: {w / (2 * np.pi):.6f} +- {sd / (2 * np.pi):.6f} Hz")
