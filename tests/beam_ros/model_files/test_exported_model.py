"""The one form that every format is written from."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import Step
from beam_ros.errors import UsageError
from beam_ros.model_files.exported_model import exported_model
from tests.beam_ros.model_files.models import (
    COVARIANCE,
    GAINS,
    OMEGAS,
    RESIDUES,
    STATIC,
    ZETAS,
    modal,
    transfer_functions,
    two_inputs,
)

W = 2.0 * np.pi * np.array([0.5, 4.3, 11.0, 60.0])


def by_hand(s: complex) -> np.ndarray:
    """Displacements under the base's acceleration, docs/identification.md."""
    return np.array(
        [
            c / s**2
            - sum(r / (s**2 + 2 * z * w * s + w**2) for r, w, z in zip(row, OMEGAS, ZETAS, strict=True))
            - static
            for c, row, static in zip(GAINS, RESIDUES, STATIC, strict=True)
        ]
    )


def test_a_moved_base_leaves_with_its_acceleration_as_the_input() -> None:
    found = exported_model([modal()], "m")
    assert (found.structure, found.input_unit, found.output_unit) == ("acceleration", "m/s2", "m")
    np.testing.assert_allclose(found.response(W)[:, :, 0], [by_hand(1j * w) for w in W], rtol=1e-10)
    for w in W:
        for j, (path,) in enumerate(found.paths):
            value = np.polyval(path.numerator, 1j * w) / np.polyval(path.denominator, 1j * w)
            assert value == pytest.approx(by_hand(1j * w)[j], rel=1e-9)
    np.testing.assert_array_equal(found.covariance, COVARIANCE)
    assert found.parameter_names[:3] == ("omega_1", "omega_2", "zeta_1")


@pytest.mark.parametrize(("drive", "power"), [("velocity", 1), ("base_motion", 2)])
def test_another_motion_is_the_input_where_it_is_asked_for(drive: str, power: int) -> None:
    found = exported_model([modal(static=False)], "m", drive)
    told = found.response(W)[:, :, 0]
    wanted = [(1j * w) ** power * (by_hand(1j * w) + STATIC) for w in W]
    np.testing.assert_allclose(told, wanted, rtol=1e-9)
    with pytest.raises(UsageError, match="residual terms differentiate the input"):
        exported_model([modal()], "m", drive)


def test_transfer_functions_of_several_outputs_stand_side_by_side() -> None:
    found = exported_model(transfer_functions(0.01), "m")
    assert (found.input_names, found.output_names) == (("u",), ("first", "second"))
    s = 1j * W
    wanted = (
        np.stack([(3 * s + 400) / (s**2 + 2 * s + 900), 7 / (s + 30)], axis=1) * np.exp(-0.01 * s)[:, None]
    )
    np.testing.assert_allclose(found.response(W)[:, :, 0], wanted, rtol=1e-12)
    np.testing.assert_array_equal(found.delays, [[0.01], [0.01]])
    assert found.parameter_names[-1] == "delay[second]"
    assert found.covariance.shape == (8, 8)


def test_every_input_of_several_has_its_column() -> None:
    found = exported_model([two_inputs()], "m")
    s = 1j * W
    wanted = np.stack([2 / (s**2 + 3 * s + 400), (s + 5) / (s**2 + 3 * s + 400)], axis=1)
    np.testing.assert_allclose(found.response(W)[:, 0], wanted, rtol=1e-12)


def test_modes_are_in_order() -> None:
    np.testing.assert_allclose([mode.omega for mode in exported_model([modal()], "m").modes], OMEGAS)


@pytest.mark.parametrize(
    ("models", "drive", "words"),
    [
        ([Step()], "", "holds a Step, not a model from input to output"),
        ([modal("force")], "velocity", "driven by a force"),
        (transfer_functions(), "velocity", "goes with a modal model alone"),
        ([modal("accelerance")], "", "residual terms differentiate the input"),
    ],
)
def test_what_no_format_can_hold_is_refused(models: list[object], drive: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        exported_model(models, "m", drive)
