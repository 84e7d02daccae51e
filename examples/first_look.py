"""First look: a frequency response without a model, and where not to trust it."""

import numpy as np
from simulated_beam import film

from beam_ident import identify, local_polynomial_response

record = film(1)
look = local_polynomial_response(record, output_names=["tip"]).series()[0]
size = np.abs(look.response)

# Resonances are where the response peaks; the frame rate of 100 Hz shows them up to 50 Hz.
for low, high in ((2.0, 10.0), (20.0, 40.0)):
    band = np.flatnonzero((look.frequencies_hz > low) & (look.frequencies_hz < high))
    peak = band[np.argmax(size[band])]
    print(f"peak of {size[peak]:6.2f} +- {look.sd[peak]:.2f} at {look.frequencies_hz[peak]:.3f} Hz")

# The lines are 1/T apart, wider than the half-power band of mode 1: no damping can be read there.
spacing = look.frequencies_hz[1] - look.frequencies_hz[0]
model = identify(record, n_modes=2).model
width = 2 * model.damping_ratios[0] * model.frequencies_hz[0]
print(f"lines every {spacing:.3f} Hz, half-power band of mode 1: {width:.3f} Hz")

# A model from the same record passes through the response and says what lies between the lines.
band = (look.frequencies_hz > 6.0) & (look.frequencies_hz < 25.0)
modelled = model.frequency_response(look.omegas[band]).response[:, 1]
distance = np.abs(look.response[band] - modelled) / np.abs(modelled)
print(f"median distance from the model between the resonances: {100 * np.median(distance):.2f} %")
