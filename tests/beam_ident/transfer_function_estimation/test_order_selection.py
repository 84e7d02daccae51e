from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, tf2ss

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord, estimate_transfer_function
from beam_ident.transfer_function_estimation import order_selection
from beam_ident.transfer_function_estimation.estimation import estimated
from beam_ident.transfer_function_estimation.order_selection import select_transfer_function
from tests.beam_ident.rao_garnier import benchmark_record


def degrees(selection):
    return selection.chosen.model.n_poles, len(selection.chosen.model.numerator) - 1


@pytest.mark.slow
@pytest.mark.parametrize("snr_db", [20.0, 5.0])
def test_the_true_degrees_are_chosen_and_the_table_says_why_others_were_not(snr_db):
    seen = []
    selection = select_transfer_function(
        benchmark_record(0, snr_db), range(3, 6), [1, 2], progress=lambda phrase, share: seen.append(share)
    )
    assert degrees(selection) == (4, 1)
    assert len(selection.table) == 6
    assert [e.is_chosen for e in selection.table].count(True) == 1
    assert seen[-1] == 1.0
    bics = [e.bic for e in selection.table]
    assert bics == sorted(bics)
    lines = str(selection).splitlines()
    assert lines[0].split()[:7] == ["poles", "zeros", "R_T^2", "YIC", "FIT", "%", "AIC"]
    assert [line.split()[1:3] for line in lines if line.startswith("->")] == [["4", "1"]]


@pytest.mark.slow
def test_processes_give_the_same_table():
    record = benchmark_record(1, 10.0)
    alone = select_transfer_function(record, [3, 4], [1])
    shared = select_transfer_function(record, [3, 4], [1], n_workers=2)
    assert degrees(alone) == degrees(shared)
    np.testing.assert_allclose([e.bic for e in alone.table], [e.bic for e in shared.table], rtol=1e-12)


@pytest.mark.slow
def test_one_start_for_each_structure_leaves_none_in_a_local_optimum_that_matters():
    record = benchmark_record(3, 5.0)
    selection = select_transfer_function(record, [4, 5], [1, 2])
    for entry in selection.table:
        thorough = estimate_transfer_function(record, entry.n_poles, entry.n_zeros)
        assert entry.bic < thorough.bic + 1.0


def test_a_structure_that_is_surpassed_begins_where_the_one_inside_it_ended():
    record = benchmark_record(3, 5.0)
    known = estimated(record, 4, 1, method="white")
    # No start of its own is refined: a pole more, or two, beside what is known leaves the fit no worse.
    for degrees in ((5, 2), (6, 3)):
        found = estimated(record, *degrees, method="white", n_starts=1, inside=(known.model,))
        assert np.sum(np.square(found.residuals)) <= np.sum(np.square(known.residuals)) * (1.0 + 1e-6)


@pytest.mark.slow
def test_slow_noise_costs_one_look_at_every_structure(monkeypatch):
    record = benchmark_record(2, 10.0)
    slow = lfilter(
        [1.0], [1.0, -0.95], np.random.default_rng(2).standard_normal(len(record.outputs[0].values))
    )
    output = record.outputs[0]
    seen = dataclasses.replace(
        output, values=output.values + 0.5 * np.std(output.values) * slow / np.std(slow)
    )
    tried = []

    def counted(records, n_poles, n_zeros, **options):
        tried.append((n_poles, n_zeros, options.get("method"), options["n_starts"]))
        return estimated(records, n_poles, n_zeros, **options)

    monkeypatch.setattr(order_selection, "estimated", counted)
    selection = select_transfer_function(TimeRecord(record.inputs, (seen,)), [3, 4, 5], [0, 1])
    assert degrees(selection) == (4, 1)
    # Under white noise each structure has one start, for it has to be estimated again under the noise as it is.
    assert sum(own[2] == "white" for own in tried) == 6
    assert all(own[3] == 1 for own in tried if own[2] == "white")


@pytest.mark.slow
def test_noise_alone_passes_no_gate():
    rng = np.random.default_rng(0)
    drive = InputSignal("u", "", (0.0, 0.01), rng.standard_normal(600))
    record = TimeRecord((drive,), (OutputSignal("y", "", (0.0, 0.01), rng.standard_normal(600)),))
    with pytest.raises(EstimationError, match="passes the gates"):
        select_transfer_function(record, [3, 4], [2])
    with pytest.raises(EstimationError, match="no structure to try"):
        select_transfer_function(record, [])


@pytest.mark.slow
def test_what_answers_at_once_gets_as_many_zeros_as_poles():
    # (s^2 + s + 3) / (s^2 + 0.4 s + 9), its steps exact under a held input.
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 300), 5)
    A, B, C, D, _ = cont2discrete(tf2ss([1.0, 1.0, 3.0], [1.0, 0.4, 9.0]), 0.01)
    y, x = np.zeros(len(u)), np.zeros((2, 1))
    for k, push in enumerate(u):
        y[k] = (C @ x + D * push).item()
        x = A @ x + B * push
    y += 0.01 * rng.standard_normal(len(u))
    drive = InputSignal("u", "N", (0.0, 0.01), u)
    record = TimeRecord((drive,), (OutputSignal("y", "m/s^2", (0.0, 0.01), y),))
    selection = select_transfer_function(record, [2])
    assert degrees(selection) == (2, 2)
    assert selection.chosen.model.numerator == pytest.approx([1.0, 1.0, 3.0], rel=0.05)
    assert {entry.n_zeros for entry in selection.table} == {0, 1, 2}


@pytest.mark.slow
def test_a_simulation_that_runs_away_is_refused():
    # x'' + 0.5 x' - 4 x = u is held upright by a loop; its open simulation is not, and scored -460 %.
    rng = np.random.default_rng(0)
    A, B, C, _, _ = cont2discrete(tf2ss([1.0], [1.0, 0.5, -4.0]), 0.01)
    reference = np.repeat(rng.choice([-1.0, 1.0], 400), 5)
    u, y, x, last = np.zeros(2000), np.zeros(2000), np.zeros((2, 1)), 0.0
    for k in range(len(u)):
        y[k] = (C @ x).item() + 1e-3 * rng.standard_normal()
        u[k] = reference[k] - 20.0 * y[k] - 5.0 * (y[k] - last) / 0.01
        last, x = y[k], A @ x + B * u[k]
    drive = InputSignal("u", "N", (0.0, 0.01), u)
    record = TimeRecord((drive,), (OutputSignal("y", "m", (0.0, 0.01), y),))
    with pytest.raises(EstimationError, match="further from the output"):
        select_transfer_function(record, [2], [0, 1], n_integrators=0, has_free_response=False)


@pytest.mark.verify
@pytest.mark.parametrize("snr_db", [20.0, 5.0])
def test_the_true_degrees_are_chosen_in_nearly_every_record(snr_db):
    right = sum(degrees(select_transfer_function(benchmark_record(k, snr_db))) == (4, 1) for k in range(30))
    assert right >= 28
