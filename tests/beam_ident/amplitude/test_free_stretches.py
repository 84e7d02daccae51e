from __future__ import annotations

import numpy as np
import pytest

from beam_ident import EstimationError, InputSignal, OutputSignal, TimeRecord
from beam_ident.amplitude.free_stretches import free_decay_of


def record(values: np.ndarray, sigma: float = 0.0) -> TimeRecord:
    times = np.arange(0.0, 10.0, 0.01)
    hub = InputSignal("hub", "m", (0.0, 0.01), values, "linear", sigma)
    return TimeRecord((hub,), (OutputSignal("z285", "m", times, np.sin(27.0 * times)),))


@pytest.mark.parametrize("noise", [0.0, 2e-5])
def test_the_stretch_begins_after_the_last_motion(noise: float) -> None:
    hub = 0.003 * np.where(np.arange(1000) < 400, np.sin(0.2 * np.arange(1000)), 0.5)
    hub += noise * np.random.default_rng(1).standard_normal(1000)
    (kept,) = free_decay_of(record(hub))
    assert kept.times_s[0] == pytest.approx(4.1, abs=0.03)
    assert kept.times_s[-1] > 9.9


def test_an_input_that_never_rests_has_no_free_decay() -> None:
    with pytest.raises(EstimationError, match="record on for at least twenty cycles"):
        free_decay_of(record(np.cumsum(np.random.default_rng(2).standard_normal(1000))))


def test_an_input_that_never_moved_leaves_everything() -> None:
    (kept,) = free_decay_of(record(np.zeros(1000)))
    assert len(kept.values) == 999
