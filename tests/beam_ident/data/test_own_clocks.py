"""Clocks of single outputs: there and back, and a record with all stamps on one."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, OutputSignal, TimeRecord
from beam_ident.data.own_clocks import OwnClock, middle_of, on_common_clock


def test_a_clock_that_is_late_and_fast_is_put_right() -> None:
    common = np.linspace(1.0, 9.0, 81)
    clock = OwnClock(2e-3, 1e-4, True)
    # By hand: the first stamp is 4 s before the middle, where a fast clock shows 0.4 ms less.
    stamps = clock.stamped(common, 5.0)
    assert stamps[0] == pytest.approx(1.0 - 0.4e-3 + 2e-3, abs=1e-12)
    assert stamps[-1] == pytest.approx(9.0 + 0.4e-3 + 2e-3, abs=1e-12)
    np.testing.assert_allclose(clock.to_common(stamps, 5.0), common, atol=1e-12)
    drive = InputSignal("hub", "m", common, np.sin(common), "cubic")
    camera, laser = (
        OutputSignal("z225", "m", common, np.cos(common)),
        OutputSignal("laser", "m", stamps, np.cos(common)),
    )
    record = TimeRecord((drive,), (camera, laser))
    assert middle_of(record) == pytest.approx(5.0 + 1.2e-3)
    put_right = on_common_clock(record, {"laser": clock})
    np.testing.assert_allclose(put_right.output("laser").times_s, common, atol=2e-7)
    np.testing.assert_array_equal(put_right.output("z225").times_s, common)
    assert on_common_clock(record, {"other": clock}) is record


def test_a_clock_that_is_given_a_rate_runs_by_itself() -> None:
    assert OwnClock(1e-3).moved(1e-3, 0.0) == OwnClock(2e-3)
    assert OwnClock(1e-3).moved(0.0, 1e-5) == OwnClock(1e-3, 1e-5, True)
