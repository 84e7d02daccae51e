"""Results: one object with one covariance; bands, storage, comparison with another model."""

import json

import numpy as np
from simulated_beam import film

from beam_ident import (
    ModalModel,
    compare_models,
    compare_step_responses,
    estimate_transfer_function,
    identify,
)

first, second = film(1), film(2)
model, other = identify(first, n_modes=2).model, identify(second, n_modes=2).model

# The frequency response with its band: small sd on a resonance, where the record had its energy.
response = model.frequency_response(2 * np.pi * np.array([2.0, 4.4, 15.0, 28.3]))
for omega, value, sd in zip(
    response.omegas, response.response[:, 1], response.magnitude_sd[:, 1], strict=True
):
    print(f"{omega / (2 * np.pi):6.2f} Hz: {abs(value):8.4f} +- {sd:.4f}")

# JSON keeps every bit.
stored = json.dumps(model.to_dict())
assert ModalModel.from_dict(json.loads(stored)).to_dict() == model.to_dict()

# Two records, one beam: differences weighed with both covariances.
comparison = compare_models(model, other)
print(
    f"chi-squared {comparison.chi_squared:.1f} on {comparison.degrees_of_freedom}: p = {comparison.p_value:.2f}"
)

# Transfer functions go to SciPy, and are compared by their step responses.
four = estimate_transfer_function(first.select(["tip"]), n_poles=4, n_zeros=4).model
again = estimate_transfer_function(second.select(["tip"]), n_poles=4, n_zeros=4).model
print(f"SciPy: {len(four.to_scipy().den)} coefficients in the denominator")
print(compare_step_responses({"first": four, "second": again}, times_s=np.linspace(0.0, 5.0, 2001)))
