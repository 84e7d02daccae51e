from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord, estimate_transfer_function
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function_estimation.common_poles import estimate_common_poles
from benchmarks.ident.common_poles import TwoInputsTwoOutputs
from benchmarks.ident.supersets import hard_record
from tests.beam_ident.rao_garnier import PARAMETERS, PERIOD_S, noise_level, prbs

DENOMINATOR = np.concatenate([[1.0], PARAMETERS[:4]])
NUMERATORS = (PARAMETERS[4:], np.array([30.0, -50.0, 900.0]))


def record(seed: int, snr_db: float = 10.0) -> TimeRecord:
    rng = np.random.default_rng(seed)
    drive = InputSignal("u", "", (0.0, PERIOD_S), prbs(2000))
    outputs = []
    for name, numerator, n in zip(("fast", "slow"), NUMERATORS, (1900, 1200), strict=True):
        stamps = np.sort(rng.uniform(0.01, 19.9, n))  # each on a clock of its own
        size = 5 + len(numerator)
        model = TransferFunctionModel(numerator, DENOMINATOR, 0.0, np.zeros((size, size)), 0.0)
        clean = model.simulate(drive, stamps)
        noise = np.std(clean) / 10 ** (snr_db / 20) * rng.standard_normal(n)
        outputs.append(OutputSignal(name, "", stamps, clean + noise))
    return TimeRecord((drive,), tuple(outputs))


def test_two_outputs_know_their_poles_better_than_either():
    both = record(0)
    joint = estimate_common_poles(both, 4, (1, 2))
    assert joint.converged
    alone = [
        estimate_transfer_function(both, 4, m, output_name=name).model
        for name, m in (("fast", 1), ("slow", 2))
    ]
    precision = [1.0 / model.standard_deviations[:4] ** 2 for model in alone]
    sd = joint.models[0].standard_deviations[:4]
    assert np.all(sd < np.min([model.standard_deviations[:4] for model in alone], axis=0))
    assert np.all(1.0 / sd**2 > 0.8 * np.sum(precision, axis=0))  # information adds up, and correlations help
    np.testing.assert_array_equal(joint.models[0].denominator, joint.models[1].denominator)
    np.testing.assert_allclose(joint.models[1].standard_deviations[:4], sd, rtol=0.01)


@pytest.mark.slow
def test_intervals_of_both_outputs_cover_the_truth():
    scores = []
    for seed in range(6):
        joint = estimate_common_poles(record(seed, 15.0), 4, (1, 2))
        for model, numerator in zip(joint.models, NUMERATORS, strict=True):
            truth = np.concatenate([DENOMINATOR[1:], numerator])
            k = len(truth)
            scores.append((model.parameters[:k] - truth) / model.standard_deviations[:k])
        assert all(w.is_white for w in joint.whiteness)
    z = np.concatenate(scores)
    assert np.max(np.abs(z)) < 4.0
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.4


def test_one_output_is_the_fit_of_that_output():
    single = record(1).select(["fast"])
    result = estimate_common_poles(single, 4, 1)
    with pytest.raises(EstimationError, match="no output 'slow'"):
        result.model("slow")
    joint = result.model("fast")
    alone = estimate_transfer_function(single, 4, 1).model
    np.testing.assert_allclose(joint.parameters, alone.parameters, rtol=1e-3)
    np.testing.assert_allclose(joint.standard_deviations, alone.standard_deviations, rtol=1e-2)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((0, 0), "expected 1 to 20 poles"),
        ((2, 3), "no more zeros than both"),
        ((2, (1, 1, 1)), "3 entries for 2 outputs"),
    ],
)
def test_impossible_requests_are_refused(arguments, says):
    with pytest.raises(EstimationError, match=says):
        estimate_common_poles(record(0), *arguments)


@pytest.fixture(scope="module")
def crossed():
    return TwoInputsTwoOutputs()


def test_two_inputs_and_two_outputs_share_one_denominator(crossed):
    estimate, sd = crossed.estimate(0)
    scores = (estimate - crossed.truth) / sd
    # 18 parameters: one beyond 4 in 800 such records, and a mean square within 1 +- 4 sqrt(2 / 18).
    assert np.max(np.abs(scores)) < 4.0
    assert np.mean(scores**2) < 2.4
    np.testing.assert_allclose(sd, crossed.bound, rtol=0.25)


def test_every_output_has_a_model_of_all_inputs(crossed):
    record = crossed.record(1)
    joint = estimate_common_poles(record, 4, [[2, 3], [1, 0]])
    assert joint.model("far").input_names == ("force", "base")
    for output, own, modelled in zip(record.outputs, joint.models, joint.modelled, strict=True):
        np.testing.assert_allclose(own.simulate(record.inputs, output.times_s), modelled, atol=1e-9)
    with pytest.raises(
        EstimationError, match="2 inputs; say which one by its name, or give for every output"
    ):
        estimate_common_poles(record, 4, (2, 1))
    with pytest.raises(EstimationError, match="expected one for each"):
        estimate_common_poles(record, 4, [[2], [1]])
    with pytest.raises(EstimationError, match="takes all inputs"):
        estimate_common_poles(record, 4, [[2, 3], [1, 0]], input_name="force")


def test_each_input_may_have_a_known_delay(crossed):
    record = crossed.record(2)
    late = tuple(
        InputSignal(d.name, d.unit, d.times_s - delay, d.values, d.hold)
        for d, delay in zip(record.inputs, (0.1, 0.05), strict=True)
    )
    known = estimate_common_poles(TimeRecord(late, record.outputs), 4, [[2, 3], [1, 0]], delay=(0.1, 0.05))
    plain = estimate_common_poles(record, 4, [[2, 3], [1, 0]])
    np.testing.assert_allclose(known.models[0].denominators[0], plain.models[0].denominators[0], rtol=1e-3)


@pytest.mark.slow
def test_a_local_optimum_of_common_poles_is_left_for_that_of_a_structure_inside():
    hard = hard_record(65, 2)
    fits = [estimate_common_poles(hard, *degrees, has_offset=True) for degrees in ((2, 1), (3, 1))]
    small, large = (sum(float(np.log(left @ left)) for left in own.residuals) for own in fits)
    assert large <= small + 1e-6  # 0.25 more, with poles that looked known


def test_a_second_output_with_the_noise_of_the_first_tells_nothing_more():
    """Taken for two witnesses, they would state standard deviations that are too small by the square root of two."""
    rng = np.random.default_rng(8)
    stamps = np.sort(rng.uniform(0.01, 19.9, 1200))
    drive = InputSignal("u", "", (0.0, PERIOD_S), prbs(2000))
    system = TransferFunctionModel(PARAMETERS[4:], DENOMINATOR, 0.0, np.zeros((7, 7)), 0.0)
    clean = system.simulate(drive, stamps)
    noise = rng.standard_normal((2, len(stamps))) * noise_level(clean, 10.0)

    def estimated(*noises: np.ndarray) -> np.ndarray:
        outputs = tuple(OutputSignal(f"y{k}", "", stamps, clean + own) for k, own in enumerate(noises))
        model = estimate_common_poles(TimeRecord((drive,), outputs), 4, 1).models[0]
        return np.asarray(model.standard_deviations[:6])

    alone, twice = estimated(noise[0]), estimated(noise[0], noise[0])
    assert twice == pytest.approx(alone, rel=0.02)
    # Of the same noise drawn anew the poles are known better; 1200 samples know a level to 2 %.
    assert estimated(*noise)[:4] == pytest.approx(alone[:4] / np.sqrt(2.0), rel=0.1)
