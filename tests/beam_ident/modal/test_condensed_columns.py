from __future__ import annotations

import numpy as np
import pytest

from beam_ident import ModalStructure, OutputSignal, Prior, TimeRecord
from beam_ident.modal import regression as regression_module
from beam_ident.modal.condensed_columns import CondensedColumns, residuals_of
from beam_ident.modal.regression import ClockState, ModalRegression
from beam_ident.modal_estimation.variable_projection import fit_modes
from tests.beam_ident.truth import OMEGAS, ZETAS, beam_record

CLOCK = ClockState(3e-4, 2e-5)


def gappy(seed: int) -> TimeRecord:
    """Return a record whose outputs miss samples of their own, one of them on stamps of its own."""
    record = beam_record(seed)
    rng = np.random.default_rng(seed)
    outputs = []
    for number, output in enumerate(record.outputs):
        values = output.values.copy()
        values[rng.random(len(values)) < 0.02 * number] = np.nan
        kept = slice(None) if number < 2 else slice(5, -300, 2)
        outputs.append(OutputSignal(output.name, "m", output.times_s[kept], values[kept], output.exposure_s))
    return TimeRecord(record.inputs, tuple(outputs))


@pytest.fixture
def long_and_whole(monkeypatch) -> tuple[ModalRegression, ModalRegression]:
    """Return the same regression over two records, in pieces and in one."""
    records = [gappy(1), gappy(2).select(["z225", "z010"])]
    whole = ModalRegression(records, ModalStructure())
    assert len(whole.pieces) == 1
    monkeypatch.setattr(regression_module, "MAX_WHOLE", 300)
    monkeypatch.setattr(regression_module, "_PIECE_ROWS", 130)
    return ModalRegression(records, ModalStructure()), whole


def test_pieces_hold_every_row_once_and_in_order(long_and_whole):
    long, whole = long_and_whole
    assert len(long.pieces) > 15
    for output, (values, times) in enumerate(zip(whole.values, whole.times, strict=True)):
        for seen, expected in (("values", values), ("times", times)):
            parts = [getattr(piece, seen)[output] for piece in long.pieces]
            np.testing.assert_array_equal(np.concatenate(parts), expected)
    expected = whole.blocks(OMEGAS, ZETAS, CLOCK, gradients=True)
    parts = [piece.blocks(OMEGAS, ZETAS, CLOCK, gradients=True) for piece in long.pieces]
    for number, block in enumerate(expected):
        for name in ("matrix", "by_time", "latency_factor", "rate_factor"):
            joined = np.concatenate([getattr(part[number], name) for part in parts])
            np.testing.assert_allclose(joined, getattr(block, name), rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(parts[0][number].mode_columns, block.mode_columns)


def test_condensed_columns_have_the_lengths_and_angles_of_all_rows(long_and_whole):
    long, whole = long_and_whole
    found = CondensedColumns.of(long, OMEGAS, ZETAS, CLOCK)
    for output, values in enumerate(whole.values):
        block = whole.blocks(OMEGAS, ZETAS, CLOCK, gradients=True)[whole.block_of[output]]
        short = found.blocks[whole.block_of[output]]
        assert len(short.matrix) < 120 < len(block.matrix)
        coefficients = np.linspace(1.0, 2.0, block.matrix.shape[1])
        all_rows, few_rows = (
            np.column_stack([own.matrix, own.slopes(coefficients, True, True), own_values])
            for own, own_values in ((block, values), (short, found.values[output]))
        )
        scale = np.linalg.norm(all_rows, axis=0)
        np.testing.assert_allclose(
            (few_rows / scale).T @ (few_rows / scale), (all_rows / scale).T @ (all_rows / scale), atol=1e-13
        )


@pytest.mark.slow
def test_a_fit_in_pieces_is_the_fit_of_the_whole(long_and_whole):
    start = OMEGAS * (1.0 + 1e-3), 1.5 * ZETAS, ClockState()
    priors = Prior(0.0, np.inf), Prior(0.0, 5e-5)
    long, whole = (fit_modes(own, *start, *priors) for own in long_and_whole)
    assert whole.converged
    assert long.converged
    reach = np.sqrt(np.diag(whole.covariance))
    # Both steps end within 1e-3 standard deviations of the optimum.
    assert np.max(np.abs(np.log(long.omegas / whole.omegas)) / reach[:3]) < 1e-3
    assert np.max(np.abs(long.zetas - whole.zetas) / reach[3:6]) < 1e-3
    np.testing.assert_allclose(np.sqrt(np.diag(long.covariance)), reach, rtol=1e-6)
    left = residuals_of(long_and_whole[1], whole.omegas, whole.zetas, whole.clock, whole.coefficients)
    for own, expected in zip(long.residuals, left, strict=True):
        np.testing.assert_allclose(own, expected, atol=1e-10)


def test_a_choice_of_stamps_keeps_values_and_stamps_together(long_and_whole):
    _, whole = long_and_whole
    few = whole.thinned(200)
    for output, times in enumerate(few.times):
        assert 150 < len(times) <= 400  # of one record or two, less what was not seen
        for segment, (record, rows) in zip(whole.segments[output], few.segments[output], strict=True):
            assert segment[0] == record
            places = segment[1].start + np.searchsorted(whole.times[output][segment[1]], times[rows])
            np.testing.assert_array_equal(whole.times[output][places], times[rows])
            np.testing.assert_array_equal(whole.values[output][places], few.values[output][rows])
    blocks = few.blocks(OMEGAS, ZETAS, CLOCK, gradients=False)
    assert [len(blocks[number].matrix) for number in few.block_of] == [len(own) for own in few.values]
