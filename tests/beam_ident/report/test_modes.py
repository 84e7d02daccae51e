"""The budget of a mode: its parts are known quantities, and add up to what the model states."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from beam_ident import Prior, identify
from beam_ident.modal.identification_result import FrequencyChange
from beam_ident.report.evidence import ErrorSources, mode_rows
from beam_ident.report.modes import add_modes
from beam_ident.report.page import Page
from tests.beam_ident.truth import beam_record


@pytest.fixture(scope="module")
def unsure():
    """Return modes of a record whose clock is known to 0.5 ppm, better than the data tell."""
    record = beam_record(1).select(("z285",))
    found = identify(record, n_modes=2, clock_rate=Prior(0.0, 5e-7))
    return found.model, mode_rows((found.model,))


@pytest.mark.slow
def test_the_parts_add_up_to_what_the_model_states(unsure):
    model, modes = unsure
    for mode in modes:
        omega_sd, zeta_sd = (column[mode.number - 1] for column in model.modes()[2:])
        assert mode.omega_sd == pytest.approx(omega_sd, rel=1e-6)
        assert mode.zeta_sd == pytest.approx(zeta_sd, rel=1e-6)


@pytest.mark.slow
def test_what_the_clock_contributes_is_what_another_clock_would_have_changed(unsure):
    model, modes = unsure
    record, off = beam_record(1).select(("z285",)), 2e-6
    held = [identify(record, n_modes=2, clock_rate=Prior(rate, 0.0)).model for rate in (-off, off)]
    slopes = (held[1].natural_frequencies - held[0].natural_frequencies) / (2.0 * off)
    for mode, slope in zip(modes, slopes, strict=True):
        expected = abs(slope) * model.clock_rate_sd
        assert mode.of_omega.clock == pytest.approx(expected, rel=0.05)


@pytest.mark.slow
def test_a_known_clock_takes_no_part():
    model = identify(beam_record(1), n_modes=2, clock_rate=Prior(0.0, 0.0)).model
    assert mode_rows((model,))[0].of_omega.clock == 0.0


def test_time_base_and_temperature_are_added_where_they_are_given(unsure):
    model, (mode, *_) = unsure
    bare = mode.of_omega
    assert np.isnan(bare.temperature)
    full = mode_rows((model,), ErrorSources(1e-3, 2.0, -1.25e-4))[0].of_omega
    assert full.time_base == pytest.approx(1e-3 * mode.omega)
    assert full.temperature == pytest.approx(2.5e-4 * mode.omega)
    assert full.together == pytest.approx(np.sqrt(bare.together**2 + full.time_base**2 + full.temperature**2))


def test_frequencies_that_changed_are_listed_from_where_to_where(unsure, tmp_path):
    page = Page("Modes", "Two modes.")
    page.section("Modes")
    changes = (
        FrequencyChange(0, "time", 4.3730, 4.3950, 0.00502, 0.00002),
        FrequencyChange(1, "swing", 28.26, 27.98, -0.0099, 0.0003, swing=0.012),
    )
    add_modes(page, unsure[1], changes=changes)
    text = page.write(tmp_path / "page.html").read_text(encoding="utf-8")
    for words in ("from the first stamp to the last", "4.37300", "4.39500", "swing of 0.012", "27.980"):
        assert words in text
