"""The JSON of the growing estimate: what is written is read, and nothing else is."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from beam_ros.messages import LiveIdentification, MessageContentError
from beam_ros.messages.live_identification import (
    LiveAim,
    LiveCost,
    LiveMode,
    LiveOutput,
    LiveResponse,
    LiveShape,
    LiveTest,
)

FULL = LiveIdentification(
    state="growing",
    sentence="two modes are known",
    record_s=12.3,
    samples={"input": 12300, "z225": 1230},
    started=1.7e9,
    modes=(LiveMode(4.41, 4e-4, 0.0052, 1e-4), LiveMode(27.9, None, 0.004, None)),
    response=LiveResponse(
        "hub/measured", (1.0, 2.0), {"z225": LiveOutput((1.0, 2.0), (0.1, 0.2), (None, 2.1))}
    ),
    shape=LiveShape((0.01, 0.225), ((0.0, 1.0), (0.1, 0.9))),
    tests=(LiveTest("residuals are white", "Ljung-Box", 0.4, "holds"),),
    aims=(LiveAim("f1", 1e-4, 3e-4, None, False),),
    cost=LiveCost(0.12, 0.4),
)


def test_what_is_written_is_read():
    assert LiveIdentification.from_json(FULL.to_json()) == FULL
    empty = replace(FULL, state="waiting", modes=(), response=None, shape=None, tests=(), started=None)
    assert LiveIdentification.from_json(empty.to_json()) == empty


def test_what_is_not_finite_is_null_to_every_reader():
    unknown = replace(FULL, modes=(LiveMode(4.41, math.nan, 0.005, math.inf),))
    read = LiveIdentification.from_json(unknown.to_json())
    assert read.modes == (LiveMode(4.41, None, 0.005, None),)


def _changed(**entries):
    return json.dumps({**json.loads(FULL.to_json()), **entries})


def _without(name):
    return json.dumps({key: value for key, value in json.loads(FULL.to_json()).items() if key != name})


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "is no JSON"),
        ("[" * 100_000, "is no JSON"),
        ("[]", "of version 'list'"),
        (_changed(version=2), "of version 2; expected 1"),
        (_without("cost"), "'cost' is missing"),
        (_changed(state="dancing"), "state is 'dancing'; expected one of"),
        (_changed(samples=[1]), r"samples is \[1\]; expected a mapping"),
        (_changed(samples={"input": 1.5}), "expected int"),
        (_changed(record_s=True), "expected a number"),
        (_changed(modes=[{"frequency_hz": 1.0}]), "frequency_sd_hz"),
        (
            _changed(shape={"heights_m": [0.1], "modes": [[1.0, 2.0]]}),
            "shape of mode 1 has 2 values; expected 1",
        ),
        (
            _changed(
                response={
                    "input": "hub/measured",
                    "frequency_hz": [1.0],
                    "outputs": {"z225": {"model": [1.0], "model_sd": [], "measured": [None]}},
                }
            ),
            "response of z225 has 0 values; expected 1",
        ),
    ],
)
def test_anything_else_is_refused_by_name(text, complaint):
    with pytest.raises(MessageContentError, match=complaint):
        LiveIdentification.from_json(text)
