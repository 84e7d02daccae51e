"""Results that went through JSON text are what they were, and what is no result is refused."""

from __future__ import annotations

import copy
import dataclasses
import functools
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from beam_ident import (
    FrequencyRecord,
    LogChirp,
    ModalModel,
    ModelFormatError,
    Multisine,
    amplitude_curves,
    identify_axis,
    restore,
)
from benchmarks.ident.driven_axis import DrivenAxis
from tests.beam_ident import result_cases


def lines_with_gap() -> FrequencyRecord:
    lines = result_cases.lines()
    gap = np.array(lines.response)
    gap[3] = np.nan
    return dataclasses.replace(lines, response=gap, degrees_of_freedom=np.inf)


MAKERS: dict[str, Callable[[], Any]] = {
    "subspace_model": lambda: result_cases.result("subspace_model"),
    "free_decay": lambda: result_cases.result("fit_free_decay"),
    "amplitude_curves": lambda: amplitude_curves(result_cases.decay()),
    "axis": lambda: identify_axis(
        DrivenAxis(duration_s=4.0, speed=0.3, period_s=2e-3).record(0), force="force"
    ),
    "best_linear_approximation": result_cases.best_linear,
    "modal_analysis": lambda: result_cases.result("analyse_modes"),
    "modal_model": lambda: result_cases.result("identify").model,
    "transfer_function": lambda: result_cases.result("estimate_transfer_function").model,
    "multi_input_model": lambda: result_cases.result("several inputs").model,
    "frequency_record": result_cases.lines,
    "frequency record with gaps": lines_with_gap,
    "frequency record without variances": lambda: FrequencyRecord([1.0, 2.0], [1.0 + 2.0j, -0.0 - 1e-300j]),
    "recipe": lambda: LogChirp(start_frequency=0.1 + 0.2),
}
"""One of everything that can be stored."""


@functools.cache
def stored(name: str) -> Any:
    return MAKERS[name]()


NAMES = tuple(MAKERS)
ADDED_LATER = {
    "harmonics",
    "decay_rate",
    "output_delays_s",
    "output_delay_sd_s",
    "output_rates",
    "output_rate_sd",
    "third_harmonic",
    "encoder",
    "known_drive_mass",
    "stiffer_than",
}
OWN = (
    "subspace_model",
    "amplitude_curves",
    "axis",
    "best_linear_approximation",
    "free_decay",
    "modal_analysis",
    "frequency_record",
)


def assert_same(first: Any, second: Any, where: str = "") -> None:
    """Fail where two results differ in type, shape or any bit."""
    assert type(first) is type(second), where
    if isinstance(first, np.ndarray):
        assert first.dtype == second.dtype, where
        assert first.shape == second.shape, where
        assert first.tobytes() == second.tobytes() or np.array_equal(first, second, equal_nan=True), where
        known = np.isfinite(first)
        np.testing.assert_array_equal(np.signbit(first[known].real), np.signbit(second[known].real))
    elif isinstance(first, tuple):
        assert len(first) == len(second), where
        for k, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_same(one, other, f"{where}[{k}]")
    elif dataclasses.is_dataclass(first):
        for own in dataclasses.fields(first):
            assert_same(getattr(first, own.name), getattr(second, own.name), f"{where}.{own.name}")
    else:
        assert first == second or (first != first and second != second), where


@pytest.mark.first_case
@pytest.mark.parametrize("name", NAMES)
def test_json_text_carries_everything_exactly(name):
    value = stored(name)
    # allow_nan=False: NaN and Infinity are no JSON, and other readers stumble over them.
    text = json.dumps(value.to_dict(), allow_nan=False)
    assert_same(restore(json.loads(text)), value)
    assert json.dumps(restore(json.loads(text)).to_dict()) == text


@pytest.mark.parametrize("name", NAMES[:-1])
def test_type_and_schema_are_stated_and_asked_for(name):
    value = stored(name)
    data = value.to_dict()
    # Frequency records carry warnings since schema 2, and so do modal analyses, which hold one; free decays have
    # the whole table of orders.
    assert data["schema"] == (2 if "record" in name or name in ("modal_analysis", "free_decay") else 1)
    assert data["type"] == (name if "record" not in name else "frequency_record")
    for change in ({"schema": data["schema"] + 1}, {"schema": None}, {"type": "spectrum"}):
        with pytest.raises(ModelFormatError, match="expected a '"):
            type(value).from_dict({**data, **change})
    with pytest.raises(ModelFormatError, match="expected the mapping that"):
        type(value).from_dict(json.dumps(data))


@pytest.mark.parametrize("name", NAMES[:-1])
def test_every_missing_entry_is_refused_by_name(name):
    value = stored(name)
    data = value.to_dict()
    for entry in set(data) - ADDED_LATER - {"schema", "type", "parameter_names"}:
        short = {key: own for key, own in data.items() if key != entry}
        with pytest.raises(ModelFormatError, match=f"the entry '{entry}' is missing"):
            type(value).from_dict(short)


@pytest.mark.parametrize("name", NAMES[:-1])
def test_entries_of_another_kind_are_refused(name):
    value = stored(name)
    for entry, own in value.to_dict().items():
        if isinstance(own, list) and own and entry not in ("parameter_names", "warnings"):
            bad = copy.deepcopy(value.to_dict())
            bad[entry] = {"a": 1}
            with pytest.raises(ModelFormatError):
                type(value).from_dict(bad)


@pytest.mark.parametrize("name", OWN)
def test_shapes_that_do_not_agree_are_refused(name):
    value = stored(name)
    data = value.to_dict()
    own = {
        "subspace_model": "denominator",
        "frequency_record": "omegas",
        "axis": "estimates",
        "best_linear_approximation": "omegas",
    }
    entry = own.get(name, "damping_ratios")
    with pytest.raises(ModelFormatError, match=r"shape|lines"):
        type(value).from_dict({**data, entry: data[entry][:-1]})


def test_entries_inside_entries_are_refused_by_their_place():
    data = stored("free_decay").to_dict()
    data["whiteness"][0].pop("band")
    with pytest.raises(ModelFormatError, match=r"whiteness\[0\].band"):
        restore(data)
    data = stored("free_decay").to_dict()
    data["orders"][0]["converged"] = "yes"
    with pytest.raises(ModelFormatError, match=r"orders\[0\].converged is 'yes'; expected bool"):
        restore(data)
    data = stored("modal_analysis").to_dict()
    data["form"] = "velocity"
    with pytest.raises(ModelFormatError, match="form is 'velocity'; expected one of 'receptance'"):
        restore(data)


@pytest.mark.parametrize(
    "data", [None, [], "modal_model", {}, {"type": "unheard of"}, {"type": ["modal_model"]}]
)
def test_what_is_no_stored_result_is_refused(data):
    with pytest.raises(ModelFormatError, match="not a stored result"):
        restore(data)


def test_a_recipe_is_known_by_its_kind():
    recipe = Multisine(0.5, 20.0, 10.0, 3, 0.5, 0.005)
    assert restore(json.loads(json.dumps(recipe.to_dict()))) == recipe
    with pytest.raises(ModelFormatError, match="not a stored recipe"):
        type(recipe).from_dict([1])


def test_a_model_of_another_kind_is_refused():
    with pytest.raises(ModelFormatError, match="'free_decay' of schema 2; expected a 'modal_model'"):
        ModalModel.from_dict(stored("free_decay").to_dict())


@pytest.mark.parametrize("bad", [{"real": [1.0]}, [1.0, 2.0], 3.0])
def test_complex_numbers_without_both_of_their_parts_are_refused(bad):
    data = stored("free_decay").to_dict() | {"amplitudes": bad}
    with pytest.raises(ModelFormatError, match="expected the entries 'real' and 'imag'"):
        restore(data)
