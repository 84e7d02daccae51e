"""Missing samples of an input, and what is said of how well they are filled in."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident import InputSignal, RecordError
from beam_ident.data.gaps import bridged, describe_gaps
from beam_ident.numerics.piecewise import Hold

PERIOD_S = 1e-3
TIMES = PERIOD_S * np.arange(6000)


def sweep(noise: float, seed: int = 0) -> np.ndarray:
    """Return a sweep from 2 to 40 Hz under white noise."""
    clean = 1e-3 * np.sin(2.0 * np.pi * (2.0 + 3.2 * TIMES) * TIMES)
    return clean + noise * np.random.default_rng(seed).standard_normal(len(TIMES))


def with_holes(values: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Return values with holes and where they are."""
    lost = np.zeros(len(values), dtype=bool)
    for first in range(300, len(values) - 300, 400):
        lost[first : first + length] = True
    return np.where(lost, np.nan, values), lost


@pytest.mark.parametrize("length", [1, 20, 60, 200])
def test_a_hole_is_filled_as_well_as_is_said(length: int) -> None:
    values = sweep(noise=1e-7)
    damaged, lost = with_holes(values, length)
    filled, gaps = bridged("hub", TIMES, damaged)
    np.testing.assert_array_equal(filled[~lost], values[~lost])
    assert [gap.missing for gap in gaps] == [length] * 14
    missed = np.array([np.sqrt(np.mean(part**2)) for part in np.split((filled - values)[lost], 14)])
    said = np.array([gap.sigma for gap in gaps])
    # Each is a root mean square of few independent numbers; over 14 holes the median is right within a factor of 3.
    assert 1.0 / 3.0 < np.median(missed / said) < 3.0
    if length <= 60:  # one and a half periods of the sweep at its end: still far below its size
        assert np.max(missed) < 5e-6


@pytest.mark.slow
def test_a_hole_near_an_end_is_filled_as_well_as_is_said() -> None:
    """There is less to see from it than from holes farther inside, by which the rules are judged."""
    duration, start, end = 10.0, 1.0, 90.0
    times = PERIOD_S * np.arange(round(duration / PERIOD_S))
    growth = np.log(end / start) / duration
    values = np.sin(2.0 * np.pi * start * np.expm1(growth * times) / growth) / np.exp(2.0 * growth * times)
    worst = 0.0
    for is_late in (False, True):
        for first in range(80, 161, 10):
            damaged = values.copy()
            damaged[first : first + 440] = np.nan
            ordered = slice(None, None, -1) if is_late else slice(None)
            filled, (gap,) = bridged("hub", times, damaged[ordered])
            missed = (filled[ordered] - values)[first : first + 440]
            worst = max(worst, float(np.sqrt(np.mean(missed**2))) / gap.sigma)
    assert worst < 5.0


def test_noise_alone_is_not_foretold() -> None:
    values = np.random.default_rng(1).standard_normal(len(TIMES))
    damaged, _ = with_holes(values, 30)
    _, gaps = bridged("hub", TIMES, damaged)
    assert np.median([gap.sigma for gap in gaps]) == pytest.approx(1.0, abs=0.25)


def test_stamps_that_wander_are_filled_by_a_straight_line() -> None:
    times = TIMES + 2e-4 * np.sin(np.arange(len(TIMES)))
    values = 3.0 * times
    damaged, _ = with_holes(values, 25)
    filled, gaps = bridged("hub", times, damaged)
    np.testing.assert_allclose(filled, values, atol=1e-12)
    assert max(gap.sigma for gap in gaps) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["zoh", "linear", "cubic", "band_limited"])
def test_a_grid_that_lacks_stamps_has_gaps_as_with_nan(hold: Hold) -> None:
    values = sweep(noise=1e-7)
    damaged, lost = with_holes(values, 20)
    lost[np.random.default_rng(2).integers(50, len(values) - 50, 900)] = True
    damaged[lost] = np.nan
    bare = InputSignal("hub", "m", TIMES[~lost], values[~lost], hold)
    marked = InputSignal("hub", "m", TIMES, damaged, hold)
    assert len(marked.gaps) > 500
    assert [gap.missing for gap in bare.gaps] == [gap.missing for gap in marked.gaps]
    np.testing.assert_allclose(bare.times_s, marked.times_s, atol=1e-12)
    np.testing.assert_allclose(bare.values, marked.values, atol=1e-12)


STEPS = {
    "irregular": 1e-3 * np.random.default_rng(0).exponential(size=400),
    "two rates": np.repeat([1e-3, 3e-3], [400, 100]),
    "where it changes": 1e-3 * np.random.default_rng(0).geometric(0.5, size=400),
}


@pytest.mark.parametrize("name", sorted(STEPS))
def test_stamps_that_are_no_grid_with_holes_have_no_gaps(name: str) -> None:
    times = np.cumsum(STEPS[name])
    values = np.random.default_rng(1).standard_normal(len(times))
    drive = InputSignal("force", "N", times, values, "zoh")
    assert drive.gaps == ()
    np.testing.assert_array_equal(drive.times_s, times)


def test_a_command_that_ends_at_zero_rests_there_until_its_last_stamp() -> None:
    times, values = np.append(TIMES[:1000], 4.0), np.append(sweep(1e-7)[:999], [0.0, 0.0])
    assert InputSignal("hub", "m/s^2", times, values, "zoh").gaps == ()
    (gap,) = InputSignal("hub", "m", times, values, "cubic").gaps
    assert (gap.start_s, gap.end_s, gap.missing) == (pytest.approx(0.999), 4.0, 3000)


def test_an_input_keeps_its_gaps_when_it_is_cut() -> None:
    drive = InputSignal("hub", "m", (0.0, PERIOD_S), with_holes(sweep(0.0), 20)[0], "cubic")
    assert len(drive.gaps) == 14
    assert np.all(np.isfinite(drive.values))
    part = drive.between(0.65, 1.2)
    assert [gap.start_s for gap in part.gaps] == pytest.approx([0.699, 1.099])
    assert [gap.missing for gap in part.gaps] == [20, 20]


def test_the_ends_of_an_input_must_be_known() -> None:
    values = sweep(0.0)
    values[-3:] = np.nan
    with pytest.raises(RecordError, match="known at both ends"):
        InputSignal("hub", "m", (0.0, PERIOD_S), values, "cubic")


def test_a_sentence_names_the_gaps_and_what_was_done() -> None:
    _, gaps = bridged("hub", TIMES, with_holes(sweep(0.0), 20)[0])
    said = describe_gaps("hub", gaps, "m", gaps[:2])
    assert "14 gaps (0.299-0.320 s" in said
    assert "and 9 more" in said
    assert "280 samples were filled in" in said
    assert "after 2 of them the motion begins anew" in said
    assert "after 3 of them the constants" in describe_gaps("hub", gaps, "m", (), gaps[:3])
    assert describe_gaps("hub", (), "m") == ""
