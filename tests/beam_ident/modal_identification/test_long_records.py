from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beam_ident import IdentificationResult, ModalModel, TimeRecord, identify
from beam_ident.modal import regression
from beam_ident.modal_estimation import weighted_fit
from beam_ident.modal_identification import estimation, fit_tests, time_search
from tests.beam_ident.modal.test_restarts import damaged
from tests.beam_ident.modal_estimation.test_weighted_fit import with_encoder_noise
from tests.beam_ident.modal_identification.test_output_delays import late
from tests.beam_ident.truth import beam_record, coloured_record


@pytest.fixture
def in_pieces(monkeypatch) -> None:
    """Take a record of a thousand samples for a long one."""
    monkeypatch.setattr(regression, "MAX_WHOLE", 500)
    monkeypatch.setattr(regression, "_PIECE_ROWS", 200)
    monkeypatch.setattr(estimation, "_MANY_STAMPS", 500)
    for module in (estimation, time_search, fit_tests):
        monkeypatch.setattr(module, "THINNED", 400)
    monkeypatch.setattr(weighted_fit, "_STRETCH", 450)


def flat(model: ModalModel) -> tuple[np.ndarray, np.ndarray]:
    values = (model.natural_frequencies, model.damping_ratios, model.residues.ravel(), model.gains)
    sds = (model.natural_frequency_sd, model.damping_ratio_sd, model.residue_sd.ravel(), model.gain_sd)
    return np.concatenate(values), np.concatenate(sds)


def with_outliers(record: TimeRecord) -> TimeRecord:
    """Return a record of which one sample in fifty is far off."""
    rng, outputs = np.random.default_rng(5), []
    for output in record.outputs:
        far = rng.random(len(output.values)) < 0.02
        outputs.append(
            dataclasses.replace(output, values=output.values + far * rng.normal(0.0, 2e-4, len(far)))
        )
    return dataclasses.replace(record, outputs=tuple(outputs))


RECORDS = {
    "white": lambda: beam_record(3),
    "coloured": lambda: coloured_record(3),
    "encoder": lambda: with_encoder_noise(3, 1e-6, 1e-6, missing=0.1),
    "several": lambda: [beam_record(1), coloured_record(2).select(["z285", "z010"])],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    ["white", "several", *(pytest.param(own, marks=pytest.mark.verify) for own in ("coloured", "encoder"))],
)
def test_a_record_in_pieces_is_identified_like_the_whole(kind, request):
    record = RECORDS[kind]()
    whole = identify(record)
    request.getfixturevalue("in_pieces")
    long = identify(record)
    assert [len(long.outputs), long.model.n_modes, long.converged] == [3, 3, True]
    (found, found_sds), (expected, sds) = flat(long.model), flat(whole.model)
    # What noise on the input does to the score is drawn, on a stretch of a long record: the mean of 16 draws is known
    # to a quarter of what that noise lets estimates scatter, and of half the record to less; deviations count it.
    is_drawn = kind == "encoder"
    assert np.max(np.abs(found - expected) / sds) < (0.6 if is_drawn else 0.1)
    np.testing.assert_allclose(found_sds, sds, rtol=0.2 if is_drawn else 1e-3)
    assert long.outputs[1].scores.fit_percent == pytest.approx(whole.outputs[1].scores.fit_percent, abs=1e-4)
    np.testing.assert_allclose(long.outputs[0].deflection, whole.outputs[0].deflection, atol=1e-7)
    for result, is_long in ((whole, False), (long, True)):
        said = any("was searched as if hub had no noise" in warning for warning in result.warnings)
        assert said == (is_long and kind == "encoder")


DIFFICULT = {
    "tails": lambda: with_outliers(beam_record(3)),
    "outliers under a colour": lambda: with_outliers(coloured_record(3)),
    "gaps": lambda: damaged(beam_record(3), ((2.0, 2.022), (4.0, 4.5))),
    "late": lambda: late(3, {"z225": -20e-3}),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        "tails",
        "gaps",
        *(pytest.param(own, marks=pytest.mark.verify) for own in ("outliers under a colour", "late")),
    ],
)
def test_pieces_weigh_by_their_noise_like_the_whole(kind, monkeypatch):
    record = DIFFICULT[kind]()
    whole = identify(record, n_modes=3)
    monkeypatch.setattr(regression, "MAX_WHOLE", 500)
    monkeypatch.setattr(regression, "_PIECE_ROWS", 200)
    monkeypatch.setattr(weighted_fit, "_STRETCH", 450)
    found, sds = flat(identify(record, n_modes=3).model)
    expected, expected_sds = flat(whole.model)
    # Two ways to the same sums, each ended by a step of less than a thousandth of a deviation. With noise found on
    # the input, here an encoder's rounding, what it does to the score is drawn on a stretch: that moves it by 0.02.
    assert np.max(np.abs(found - expected) / expected_sds) < {"gaps": 2e-3, "late": 0.06}.get(kind, 0.03)
    np.testing.assert_allclose(sds, expected_sds, rtol={"gaps": 1e-4, "late": 0.1}.get(kind, 2e-3))


def stopped_at(phrase: str, error: type[BaseException], record: TimeRecord) -> IdentificationResult:
    def progress(said: str, share: float) -> None:
        del share
        if said == phrase:
            raise error

    return identify(record, progress=progress)


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("phrase", "error", "said", "n_modes"),
    [
        ("looking for mode 2", KeyboardInterrupt, "interrupted; missing is the search for more than 1", 1),
        ("looking for mode 3", TimeoutError, "the time was up; missing is the search for more than 2", 2),
        ("weighing by the noise as it is", MemoryError, "memory did not suffice; missing is the weighing", 3),
    ],
)
def test_what_is_found_is_not_lost_when_a_later_step_fails(phrase, error, said, n_modes):
    found = stopped_at(phrase, error, beam_record(3))
    assert found.model.n_modes == n_modes
    assert not found.converged
    assert said in found.reason
    assert any(said in warning for warning in found.warnings)


@pytest.mark.slow
@pytest.mark.usefixtures("in_pieces")
def test_what_some_samples_show_is_not_lost_when_all_are_too_many():
    found = stopped_at("fitting to all samples", MemoryError, beam_record(3))
    assert found.model.n_modes == 3
    assert "missing is the fit to more than 400 stamps" in found.reason
    assert len(found.outputs[0].residuals) == 400
    whole = flat(identify(beam_record(3)).model)
    few, few_sds = flat(found.model)
    assert np.max(np.abs(few - whole[0]) / few_sds) < 4.0


def test_an_estimation_that_has_found_nothing_yet_is_interrupted():
    with pytest.raises(KeyboardInterrupt):
        stopped_at("looking for mode 1", KeyboardInterrupt, beam_record(3))


@pytest.mark.slow
def test_a_model_is_not_lost_when_a_later_look_for_delays_is_stopped():
    looks = []

    def progress(said: str, share: float) -> None:
        del share
        looks.append(said)
        if said == "looking for mode 1" and "weighing by the noise as it is" in looks:
            raise TimeoutError

    found = identify(late(1, {"z225": -50e-6}), n_modes=3, progress=progress)
    assert found.model.n_modes == 3
    assert not found.converged
    assert "the time was up; missing is a further look for clocks" in found.reason
