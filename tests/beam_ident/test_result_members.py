"""What every result has, by the same name and meaning: the contract in code and its table in the docs."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from beam_ident import (
    ESTIMATORS,
    InputSignal,
    LineResult,
    OutputSignal,
    Result,
    Scores,
    TimeRecord,
    TimeResult,
    Whiteness,
    models_of,
    restore,
    subspace_model,
)
from tests.beam_ident import result_cases

PAGE = Path(__file__).parents[2] / "docs" / "results.md"
OF_TWO_OUTPUTS = set(result_cases.OVER_SEVERAL_OUTPUTS) - {"fit_free_decay"}


@pytest.mark.parametrize("contract", [Result, TimeResult, LineResult])
def test_the_docs_list_the_members_of_every_contract(contract):
    text = re.search(rf"^\| `{contract.__name__}`.*?\n(?=\| `\w+Result`|\n)", PAGE.read_text(), re.M | re.S)
    rows = [row.split("|") for row in text[0].splitlines()]
    listed = [name for row in rows for name in re.findall(r"`(\w+)`", row[2])]
    assert sorted(listed) == sorted(name for name, own in vars(contract).items() if isinstance(own, property))


@pytest.mark.first_case
@pytest.mark.parametrize("name", result_cases.ALL)
def test_every_result_keeps_its_contract(name):
    found = result_cases.result(name)
    assert isinstance(found, Result)
    assert isinstance(found, TimeResult) == (name not in result_cases.OVER_LINES)
    assert isinstance(found, LineResult) == (name in result_cases.OVER_LINES)


@pytest.mark.parametrize("name", result_cases.ALL)
def test_every_result_prints_what_a_reader_needs_first(name):
    found = result_cases.result(name)
    lines = str(found).splitlines()
    assert 3 <= len(lines) <= 40
    assert max(map(len, lines)) < 200
    assert repr(found) == str(found)
    # 20 rad/s, however it was estimated; and the notebook's table has what the terminal's has.
    hertz = [row[1] for row in map(str.split, lines) if row[0] == "1"]
    assert [float(own) for own in hertz] == pytest.approx([20.0 / (2.0 * np.pi)] * len(hertz), rel=0.02)
    assert hertz
    assert all(f"<td>{own}" in found._repr_html_() for own in hertz)
    assert all(text.split(". ")[0][:60] in str(found).replace("\n", " ") for text in found.warnings)


@pytest.mark.parametrize("name", result_cases.ALL)
def test_every_result_gives_its_modes_as_columns_and_draws_where_they_lie(name):
    found = result_cases.result(name)
    columns = found.mode_columns()
    assert len({len(values) for values in columns.values()}) == 1
    assert columns["frequency_hz"] == pytest.approx(20.0 / (2.0 * np.pi), rel=0.02)
    assert columns["damping_ratio"] == pytest.approx(0.1, rel=0.2)
    with np.errstate(invalid="ignore"):
        assert not np.any(columns["frequency_sd_hz"] > 0.1)  # in the unit of its value
    assert columns["model"].tolist() == sorted(columns["model"].tolist())
    page = found._repr_html_()
    picture = ElementTree.fromstring(page[page.index("<svg") :])
    assert len(picture.findall(".//{*}circle")) == len(columns["mode"])
    try:
        frame = found.to_dataframe()
    except ImportError as err:
        assert "take mode_columns()" in str(err)  # noqa: PT017  pandas may be there, and need not
    else:
        assert frame["frequency_hz"].tolist() == columns["frequency_hz"].tolist()


def test_records_print_what_they_hold():
    assert str(result_cases.record()).splitlines()[2].split() == [
        *("u", "input", "N", "1024", "100", "0", "to", "10.23"),
        *str(result_cases.record()).splitlines()[2].split()[-3:],
    ]
    assert "lines from" in str(result_cases.lines())


@pytest.mark.parametrize("name", result_cases.BY_NAME)
def test_what_the_table_promises_is_kept_and_the_models_can_be_stored(name):
    found = result_cases.result(name)
    assert isinstance(found, ESTIMATORS[name].result)
    for model in models_of(found):
        assert restore(json.loads(json.dumps(model.to_dict(), allow_nan=False))).to_dict() == model.to_dict()
        omegas, zetas, omega_sd, zeta_sd = model.modes()
        assert omegas == pytest.approx([20.0], rel=0.01)
        assert zetas == pytest.approx([0.1], rel=0.1)
        assert omega_sd.shape == zeta_sd.shape == (1,)


@pytest.mark.parametrize("name", result_cases.ALL)
def test_every_result_says_how_it_ended(name):
    found = result_cases.result(name)
    assert found.converged is True
    assert isinstance(found.reason, str)
    assert isinstance(found.iterations, int)
    assert isinstance(found.warnings, tuple)


@pytest.mark.parametrize("name", result_cases.OVER_ONE_OUTPUT)
def test_measured_is_modelled_and_residuals(name):
    found = result_cases.result(name)
    assert found.times_s.shape == found.measured.shape
    np.testing.assert_allclose(found.measured - found.modelled, found.residuals, rtol=0.0, atol=1e-12)
    assert found.scores == Scores.of(found.measured, found.residuals)
    assert isinstance(found.whiteness, Whiteness)
    assert found.scores.fit_percent > 90.0


@pytest.mark.parametrize("name", result_cases.OVER_SEVERAL_OUTPUTS)
def test_measured_is_modelled_and_residuals_of_every_output(name):
    found = result_cases.result(name)
    rows = zip(
        found.times_s,
        found.measured,
        found.modelled,
        found.residuals,
        found.scores,
        found.whiteness,
        strict=True,
    )
    count = 0
    for times, measured, modelled, residuals, scores, whiteness in rows:
        assert times.shape == measured.shape
        np.testing.assert_allclose(measured - modelled, residuals, rtol=0.0, atol=1e-12)
        assert scores.fit_percent == pytest.approx(Scores.of(measured, residuals).fit_percent)
        assert isinstance(whiteness, Whiteness)
        count += 1
    assert count == (2 if name in OF_TWO_OUTPUTS else 1)


@pytest.mark.parametrize("name", ["identify", "estimate_common_poles", "transfer_function"])
def test_records_say_what_belongs_to_each_of_them_for_every_output(name):
    found = result_cases.result(name)
    assert len(found.records) == len(found.measured)
    for parts, measured in zip(found.records, found.measured, strict=True):
        np.testing.assert_array_equal(np.concatenate([own.measured for own in parts]), measured)


@pytest.mark.parametrize("name", result_cases.OVER_LINES)
def test_the_response_is_modelled_and_residuals(name):
    found = result_cases.result(name)
    is_of_records = name in result_cases.OVER_RECORDS
    own = found.records[0] if is_of_records else found.record
    modelled, residuals = found.modelled, found.residuals
    if is_of_records:
        modelled, residuals = modelled[0], residuals[0]
    np.testing.assert_allclose((modelled + residuals).ravel(), own.response.ravel(), rtol=1e-12)
    assert found.misfit.chi_squared == pytest.approx(
        np.nansum(np.abs(residuals) ** 2 / (0.5 * own.variance.reshape(residuals.shape))), rel=1e-6
    )


def test_a_subspace_of_noise_is_said_to_be_one():
    rng = np.random.default_rng(5)
    drive = InputSignal("u", "", (0.0, 0.01), rng.standard_normal(1000), "zoh")
    noise = OutputSignal("y", "", 0.01 * np.arange(1, 1000), rng.standard_normal(999))
    assert "no more than chance" in subspace_model(TimeRecord((drive,), (noise,)), 4).warnings[0]
    assert result_cases.result("subspace_model").warnings == ()


def test_what_is_known_of_the_clock_has_no_covariance_with_anything():
    found = result_cases.result("identify").model  # a receptance: its signals share a clock
    known = [found.parameter_names.index(name) for name in ("latency", "clock_rate")]
    assert not np.any(found.covariance[known, :])
    assert not np.any(found.covariance[:, known])
