from __future__ import annotations

import numpy as np
import pytest

from beam_ident.modal.model import ModalModel


def model(structure, parameters, covariance):
    own = parameters[6:].reshape(2, 4)
    return ModalModel(
        structure=structure,
        input_name="u",
        output_names=("a", "b"),
        natural_frequencies=parameters[:2],
        damping_ratios=parameters[2:4],
        latency=0.0,
        clock_rate=0.0,
        gains=own[:, 0],
        residual_terms=own[:, 1],
        residues=own[:, 2:],
        covariance=covariance,
        noise_sd=np.ones(2),
    )


DIRECT = {
    "base_motion": lambda s: 1,
    "velocity": lambda s: 1 / s,
    "acceleration": lambda s: 1 / s**2,
    "force": lambda s: 1 / s**2,
    "receptance": lambda s: 0,
}
FRONT = {
    "base_motion": lambda s: -(s**2),
    "velocity": lambda s: -s,
    "acceleration": lambda s: -1,
    "force": lambda s: 1,
    "receptance": lambda s: 1,
}


def by_hand(structure, p, s):
    own = p[6:].reshape(2, 4)
    return np.array(
        [
            gain * DIRECT[structure](s)
            + FRONT[structure](s)
            * (
                term
                + sum(
                    r / (s**2 + 2 * z * w * s + w**2) for r, w, z in zip(residues, p[:2], p[2:4], strict=True)
                )
            )
            for gain, term, *residues in own
        ]
    )


@pytest.mark.parametrize("structure", DIRECT)
def test_the_bands_of_a_response_follow_from_its_differences_by_every_parameter(structure):
    parameters = np.array([27.5, 180.0, 0.005, 0.01, 0.0, 0.0, 1.0, 1e-5, 1.2, -0.4, 0.9, -2e-5, 0.5, 0.7])
    factor = np.random.default_rng(0).standard_normal((14, 14)) * 1e-3 * np.abs(parameters)[:, None]
    omegas = np.array([3.0, 27.4, 60.0, 182.0])
    found = model(structure, parameters, factor @ factor.T).frequency_response(omegas)
    for k, omega in enumerate(omegas):
        here = by_hand(structure, parameters, 1j * omega)
        np.testing.assert_allclose(found.response[k], here, rtol=1e-12)
        steps = np.diag(1e-6 * np.abs(parameters))
        slopes = np.array(
            [
                (
                    by_hand(structure, parameters + h, 1j * omega)
                    - by_hand(structure, parameters - h, 1j * omega)
                )
                / 2e-6
                for h in steps
            ]
        )  # by the logarithm of every parameter
        relative = factor / np.where(parameters == 0.0, 1.0, np.abs(parameters))[:, None]
        moved = relative.T @ slopes  # shape (14 directions of unit variance, 2 outputs)
        expected = np.stack([moved.real, moved.imag])
        # Central differences of 1e-6 at a resonance of 0.5 %: (1e-6/0.005)^2, and rounding.
        for j in range(2):
            size = np.linalg.norm(moved[:, j]) ** 2
            np.testing.assert_allclose(
                found.covariance[k, j], expected[:, :, j] @ expected[:, :, j].T, rtol=1e-5, atol=1e-6 * size
            )
        turned = moved / here
        np.testing.assert_allclose(
            found.magnitude_sd[k], np.abs(here) * np.linalg.norm(turned.real, axis=0), rtol=1e-5
        )
        np.testing.assert_allclose(found.phase_sd[k], np.linalg.norm(turned.imag, axis=0), rtol=1e-5)
