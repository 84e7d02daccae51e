"""What changes or limits the force of a record is named where forces outweigh the sensor's noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from beam_ident import TimeRecord, identify_axis
from benchmarks.ident.driven_axis import DrivenAxis


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: np.where(np.arange(len(f)) < len(f) // 2, f, 0.8 * f), "halves of the record disagree"),
        (
            lambda f: np.clip(f, *(0.6 * np.array([np.min(f), np.max(f)]))),
            "stands at its largest or smallest",
        ),
        (lambda f: f + 0.02 * np.std(f) * np.random.default_rng(0).standard_normal(len(f)), ""),
    ],
    ids=["gain", "limit", "noise"],
)
def test_what_changes_the_force_is_named(change: Callable[[np.ndarray], np.ndarray], words: str) -> None:
    record = DrivenAxis(duration_s=8.0, noise=1e-6).record(1)
    drive = replace(record.input("force"), values=change(record.input("force").values))
    found = identify_axis(TimeRecord((drive,), record.outputs))
    assert found.method == "instrumental_variables"
    named = [warning for warning in found.warnings if "halves" in warning or "stands at" in warning]
    assert [words in warning for warning in named] == [True] * bool(words)
