"""Whatever kind of model is validated, the deflection is what the moved base does not carry along."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import ModalModel, TransferFunctionModel, validate
from tests.beam_ident.truth import beam_record


def carried_along(output: str) -> TransferFunctionModel:
    """A point that follows the hub, as if it stood on it."""
    return TransferFunctionModel(
        np.array([1.0]), np.array([1.0]), 0.0, np.zeros((2, 2)), 1e-6, input_name="hub", output_name=output
    )


def carried_modal(output: str) -> ModalModel:
    """The same as a modal model: a mode far away that has no part in it."""
    return ModalModel(
        structure="base_motion",
        input_name="hub",
        output_names=(output,),
        natural_frequencies=np.array([1e3]),
        damping_ratios=np.array([0.5]),
        residues=np.zeros((1, 1)),
        residual_terms=np.zeros(1),
        gains=np.ones(1),
        latency=0.0,
        clock_rate=0.0,
        covariance=np.zeros((7, 7)),
        noise_sd=np.full(1, 1e-6),
    )


@pytest.mark.parametrize("model_of", [carried_along, carried_modal], ids=["transfer function", "modal"])
def test_a_model_without_a_beam_gets_no_credit_for_the_motion_of_the_base(model_of):
    record = beam_record(1).select(
        ["z010"]
    )  # 10 mm above the clamp: hardly anything but the hub's own motion
    (found,) = validate(model_of("z010"), record).outputs
    assert found.scores.fit_percent > 95.0
    assert abs(found.deflection_scores.fit_percent) < 2.0
