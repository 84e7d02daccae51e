from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import beam_ros
from beam_ros.process import strict_json as module
from beam_ros.process.strict_json import strict_json


def test_what_json_does_not_know_becomes_null_at_any_depth():
    content = {"a": math.nan, 2: [1.5, (math.inf, -math.inf)], "c": {"d": np.float64("nan"), "e": None}}
    text = strict_json(content, indent=2)
    found = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert found == {"a": None, "2": [1.5, [None, None]], "c": {"d": None, "e": None}}


def test_nothing_in_the_package_writes_json_by_another_way():
    sources = set(Path(beam_ros.__file__).parent.rglob("*.py")) - {Path(module.__file__)}
    assert [str(path) for path in sources if "json.dump" in path.read_text()] == []
