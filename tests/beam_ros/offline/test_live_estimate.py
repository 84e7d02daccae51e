"""The estimate that grows says, at the end, what the bag says; and what is wrong with what it hears, in words."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from beam_ident import EstimationError
from beam_ros.bags.batches import encode_batch
from beam_ros.bags.reading import Bag, RawMessage
from beam_ros.interfaces.graph import LIVE_NEEDS
from beam_ros.interfaces.rig_parameters import LiveSettings
from beam_ros.messages import LiveIdentification
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.live_estimate import LiveEstimate

ROOT = Path(__file__).resolve().parents[3]
CHIRP = ROOT / "bags" / "chirp_6s"


class Processor:
    """A processor that takes hardly any time."""

    now = 0.0

    def __call__(self) -> float:
        self.now += 1e-9
        return self.now


def heard(bag: Path = CHIRP) -> Iterator[tuple[str, RawMessage]]:
    with Bag(bag) as opened:
        names = {opened.full_name(topic): topic for topic in LIVE_NEEDS if opened.count(topic)}
        for raw in opened.raw_messages(*names.values()):
            yield names[raw.topic], raw


def estimate(aims: str = "", memory_s: float = 600.0) -> LiveEstimate:
    return LiveEstimate(LiveSettings(aims, 0.15, memory_s, 0), Processor())


def grown(
    live: LiveEstimate, stream: Iterator[tuple[str, RawMessage]], every_s: float
) -> list[LiveIdentification]:
    """What is said as the messages of a stream come, looked at every so many seconds."""
    said, next_ns = [live.step()], 0
    for topic, raw in stream:
        live.hear(topic, raw.data, raw.receive_ns)
        if raw.receive_ns >= next_ns:
            next_ns = raw.receive_ns + round(every_s * 1e9)
            if (newest := live.step()) is not said[-1]:
                said.append(newest)
    said.append(live.step())
    return said


@pytest.fixture(scope="module")
def said() -> list[LiveIdentification]:
    return grown(estimate("f1:0.01%, zeta2:1e-9"), heard(), 1.5)


@pytest.mark.slow
def test_the_last_answer_is_that_of_the_recorded_bag(said) -> None:
    last, model = said[-1], identification_of_bags(CHIRP).result.model
    assert last.state == "ended"
    assert [mode.frequency_hz for mode in last.modes] == model.frequencies_hz.tolist()
    assert [mode.damping_ratio_sd for mode in last.modes] == model.damping_ratio_sd.tolist()
    assert last.samples["input"] == 6800
    assert last.record_s == pytest.approx(6.799)


@pytest.mark.slow
def test_it_waits_grows_and_ends(said) -> None:
    states = [own.state for own in said]
    assert states[0] == "waiting"
    assert "Nothing on hub/measured and beam/displacement yet" in said[0].sentence
    assert "growing" in states
    growing = [own for own in said if own.state == "growing"]
    assert growing[-1].modes[0].frequency_sd_hz < growing[0].modes[0].frequency_sd_hz
    for own in said:
        assert LiveIdentification.from_json(own.to_json()).state == own.state


@pytest.mark.slow
def test_the_response_the_shapes_and_the_aims_are_those_of_the_model(said) -> None:
    last = said[-1]
    assert last.response is not None
    assert len(last.response.frequency_hz) <= 200
    hertz = np.array(last.response.frequency_hz)
    tip = last.response.outputs["z225"]
    assert hertz[np.argmax(tip.model)] == pytest.approx(last.modes[0].frequency_hz, rel=1e-3)
    seen = [(value, model) for value, model in zip(tip.measured, tip.model, strict=True) if value is not None]
    assert seen
    assert last.shape is not None
    assert last.shape.heights_m == (0.01, 0.225, 0.285)
    assert max(map(abs, last.shape.modes[0])) == 1.0
    aims = {aim.name: aim for aim in last.aims}
    assert aims["f1"].met
    assert aims["f1"].seconds_to_go == 0.0
    assert not aims["zeta2"].met
    assert aims["zeta2"].seconds_to_go > 1e3
    believed = [test for test in last.tests if test.assumption.startswith("mode ")]
    assert [test.verdict for test in believed] == ["holds"] * len(last.modes)
    assert len(last.tests) > len(believed)  # and what the intervals rest on


@pytest.mark.slow
def test_an_aim_that_is_met_is_said_before_the_end() -> None:
    said = grown(estimate("f1:0.01%"), heard(), 1.0)
    known = [own for own in said if own.state == "known"]
    assert known
    assert "the experiment may stop" in known[0].sentence
    assert known[0].record_s < said[-1].record_s


@pytest.mark.slow
def test_an_aim_out_of_reach_is_said_with_the_record_that_it_would_take(said) -> None:
    assert "zeta2 to 1e-07 % would take a record of about" in said[-1].sentence
    assert "600 s are kept: give live.memory more" in said[-1].sentence
    # While the excitation goes on, the table tells the time to go.
    assert all("would take" not in own.sentence for own in said if own.state == "growing")
    last = grown(estimate("f1:0.01%, zeta1:0.005%, f9:1%"), heard(), 3.0)[-1]
    assert "f1 to" not in last.sentence
    assert "zeta1 to 0.005 % would take a record of about" in last.sentence
    assert "s, at this excitation" in last.sentence
    assert "f9 to 1 % is not reached, for no mode 9 is known" in last.sentence


@pytest.mark.slow
def test_a_short_memory_is_the_identification_of_the_newest_samples() -> None:
    live = estimate(memory_s=4.0)
    last = grown(live, heard(), 1.0)[-1]
    assert last.state == "ended"
    assert "known from the newest" in last.sentence
    assert 3.9 < last.record_s < 4.1
    with Bag(CHIRP) as bag:
        newest_s = bag.duration_ns * 1e-9
    model = identification_of_bags(CHIRP, start_s=newest_s - 4.0).result.model
    assert len(last.modes) == model.n_modes
    for mode, hertz, sd in zip(last.modes, model.frequencies_hz, model.frequency_sd_hz, strict=True):
        assert abs(mode.frequency_hz - hertz) < 0.1 * sd


def changed(change) -> Iterator[tuple[str, RawMessage]]:
    """Messages of which some are other ones, or none."""
    begun = next(raw.receive_ns for topic, raw in heard() if topic == "hub/measured")
    for topic, raw in heard():
        other = change(topic, raw, (raw.receive_ns - begun) * 1e-9)
        if other is not None:
            yield topic, other


def _batch_moved(raw: RawMessage, by_ns: int, epoch: int | None = None) -> RawMessage:
    from dataclasses import replace

    from beam_ros.bags.batches import decode_batch

    batch = decode_batch(raw.data)
    moved = replace(batch, stamp_ns=batch.stamp_ns + by_ns, epoch=batch.epoch if epoch is None else epoch)
    return raw._replace(data=encode_batch(moved))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda topic, raw, at_s: None if topic == "hub/measured" else raw, "Nothing on hub/measured yet"),
        (
            lambda topic, raw, at_s: None if topic == "beam/displacement" else raw,
            "Nothing on beam/displacement",
        ),
        (
            lambda topic, raw, at_s: None if topic == "hub/measured" and 3.0 < at_s < 3.1 else raw,
            "hub/measured has 1 gap",
        ),
        (
            lambda topic, raw, at_s: (
                _batch_moved(raw, 0, 2) if topic in ("hub/measured", "hub/applied") and at_s > 3.0 else raw
            ),
            "the device restarted 1 times",
        ),
        (
            lambda topic, raw, at_s: (
                _batch_moved(raw, -2_000_000_000)
                if topic in ("hub/measured", "hub/applied") and at_s > 4.0
                else raw
            ),
            "hub/measured",
        ),
        (
            lambda topic, raw, at_s: (
                raw._replace(data=b"\x00\x01") if topic == "hub/measured" and at_s > 6.0 else raw
            ),
            "cannot be read",
        ),
    ],
    ids=["no input", "no markers", "gap", "restart", "clock steps back", "damaged"],
)
def test_what_is_wrong_with_what_is_heard_is_said_in_words(change, words) -> None:
    last = grown(estimate(), changed(change), 3.0)[-1]
    assert words in last.sentence, last.sentence
    assert "Traceback" not in last.sentence


def test_aims_that_are_none_are_refused_at_once() -> None:
    with pytest.raises(EstimationError, match=r"expected f1:0\.01%"):
        estimate("fast")
