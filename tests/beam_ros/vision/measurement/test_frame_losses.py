"""Films whose frames were dropped, jittered or unevenly spaced, with no word of it in the file: mended or refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lsim

from beam_ros.bags.reading import Bag
from beam_ros.rig.rig import Rig
from beam_ros.vision.errors import SynchronisationError
from beam_ros.vision.measurement.frame_losses import _RECURSION, FilmTimes, _breaks, time_film

RECORDINGS = Path(__file__).parents[4] / "bags"
PERIOD = 0.01
LIMIT = 0.2e-3


class Experiment:
    """The experiment of ``bags/chirp_6s``, to be filmed at any times."""

    def __init__(self) -> None:
        with Bag(RECORDINGS / "chirp_6s") as bag:
            hub = bag.hub_samples()
        self.hub_t = (hub.stamps_ns - hub.stamps_ns[0]) * 1e-9
        self.hub_x = hub.positions
        self.hub = CubicSpline(self.hub_t, self.hub_x)
        truth = json.loads((RECORDINGS / "video_96x240" / "truth.json").read_text())
        camera = Rig.from_file(RECORDINGS / "video_96x240" / "rig.yaml").camera_parameters()
        self.begun = (truth["first_frame_ns"] - int(hub.stamps_ns[0])) * 1e-9
        columns = np.array(truth["columns_px"])
        self.n_frames = len(columns)
        self.high = CubicSpline(
            np.arange(self.n_frames) * PERIOD,
            (columns[:, 1:] - camera.origin_px[0]) / camera.pixels_per_metre,
        )

    def film(self, times: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        hub = self.hub(times + self.begun) + 2e-6 * rng.standard_normal(len(times))
        high = self.high(times)
        return hub, high + 2e-6 * rng.standard_normal(high.shape)

    def timed(self, times: np.ndarray, rng: np.random.Generator, period: float | None = PERIOD) -> FilmTimes:
        hub, high = self.film(times, rng)
        stated = np.arange(len(times)) * PERIOD if period else times
        return time_film(self.hub_t, self.hub_x, stated, hub, period_s=period, high_markers_m=high)

    def error(self, found: FilmTimes, times: np.ndarray) -> np.ndarray:
        """Error of the time of every frame that is called timed [s]."""
        stated = np.arange(len(times)) * PERIOD + found.lost * PERIOD
        return (found.synchronisation.hub_times(stated) - times - self.begun)[found.is_timed]


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return Experiment()


def dropped(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """Times of the frames that are left."""
    keep = np.ones(n, dtype=bool)
    if kind == "one":
        keep[rng.integers(1, n - 1)] = False
    elif kind == "many":
        keep[rng.choice(np.arange(1, n), rng.integers(5, 60), replace=False)] = False
    elif kind == "bursts":
        for _ in range(rng.integers(1, 4)):
            at = rng.integers(1, n - 1)
            keep[at : at + rng.integers(2, 40)] = False
    return np.flatnonzero(keep) * PERIOD


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["none", "one", "many", "bursts"])
def test_frames_that_were_dropped_without_a_word_are_found_and_the_rest_gets_its_right_times(
    experiment, kind
):
    rng = np.random.default_rng([1, *kind.encode()])
    refused = 0
    for _ in range(4):
        times = dropped(kind, experiment.n_frames, rng)
        try:
            found = experiment.timed(times, rng)
        except SynchronisationError:
            refused += 1
            continue
        assert found.is_timed.mean() > 0.4
        assert np.abs(experiment.error(found, times)).max() < LIMIT
        if kind == "none":
            assert found.n_lost == 0
            assert found.is_timed.all()
    # Bursts may leave frames that nobody can place, or too little in one piece to begin with.
    assert refused <= (3 if kind == "bursts" else 0)


def test_a_frame_lost_while_the_hub_rests_breaks_the_swing_and_ends_what_is_timed(experiment):
    rng = np.random.default_rng(2)
    lost = experiment.n_frames - 60
    times = np.delete(np.arange(experiment.n_frames), lost) * PERIOD
    found = experiment.timed(times, rng)
    assert not found.is_timed[lost:].any()
    assert found.is_timed[: lost - 20].all()


@pytest.mark.slow
def test_a_mode_that_wakes_while_the_hub_seems_to_rest_is_no_lost_frame():
    # Its swing broke the recursion, as it was not there before: frames of a film without losses were not timed.
    t = np.arange(30_000) * 5e-4
    acceleration = np.where(t < 13.5, 3.0 * np.sin(2 * np.pi * (0.5 * t + 3.3 * t**2)), 0.0)
    hub = lsim(([1.0], [1.0, 2.6, 3.6]), acceleration, t)[1]
    forcing, high = np.gradient(np.gradient(hub, t), t), hub.copy()
    for gain, hertz in ((1.3, 4.6), (-0.4, 29.0), (0.2, 81.0)):
        omega = 2 * np.pi * hertz
        high -= gain * lsim(([1.0], [1.0, 0.01 * omega, omega**2]), forcing, t)[1]
    frames = np.arange(1, 1490)
    seen = CubicSpline(t, np.stack([hub, high], axis=1))(frames[:, None] * PERIOD + 1e-3 * np.arange(-2, 3))
    seen = seen.mean(axis=1) + 4e-6 * np.random.default_rng(8).standard_normal((len(frames), 2))
    for kept in (frames, np.delete(frames, 1310)):
        film, stated = seen[kept - 1], np.arange(len(kept)) * PERIOD
        found = time_film(t[::2], hub[::2], stated, film[:, 0], period_s=PERIOD, high_markers_m=film[:, 1:])
        wrong = np.abs(found.synchronisation.hub_times(stated + found.lost * PERIOD) - kept * PERIOD)
        assert wrong[found.is_timed].max() < LIMIT
        assert found.is_timed[:1250].all()
        assert len(kept) < len(frames) or found.is_timed.all()


@pytest.mark.parametrize("is_one_silent", [False, True])
def test_gaps_that_the_container_tells_break_no_swing(experiment, is_one_silent):
    # The recursion counted rows across them: of a film that lacked nothing else 142 frames were not timed.
    numbers = np.flatnonzero(np.arange(experiment.n_frames) % 37 != 5)
    told, silent = numbers, experiment.n_frames
    if is_one_silent:
        # While the hub rests.
        silent = int(numbers[-60])
        numbers = numbers[numbers != silent]
        told = numbers - (numbers > silent)
    hub, high = experiment.film(numbers * PERIOD, np.random.default_rng(10))
    found = time_film(
        experiment.hub_t, experiment.hub_x, told * PERIOD, hub, period_s=PERIOD, high_markers_m=high
    )
    wrong = found.synchronisation.hub_times((told + found.lost) * PERIOD) - numbers * PERIOD
    assert np.abs(wrong - experiment.begun)[found.is_timed].max() < LIMIT
    assert found.is_timed[numbers < silent - 20].all()
    assert not found.is_timed[numbers > silent].any()


def test_across_a_gap_a_swing_neither_breaks_nor_tells_that_nothing_is_lost():
    gap, numbers = 200, np.delete(np.arange(400), [200, 201])
    t = numbers * PERIOD
    high = np.stack([np.sin(30.0 * t), np.sin(30.0 * t) + 0.3 * np.sin(170.0 * t)], axis=1)
    high += 1e-3 * np.random.default_rng(11).standard_normal(high.shape)
    hub = np.zeros((len(t), 4 * _RECURSION + 1))
    broken, silent = _breaks(high, hub, numbers - np.arange(len(t)), np.ones(len(t), dtype=bool))
    assert not broken.any()
    assert np.array_equal(np.flatnonzero(silent[_RECURSION:]) + _RECURSION, np.arange(gap, gap + _RECURSION))


@pytest.mark.first_case
@pytest.mark.parametrize("kind", ["jitter", "variable"])
def test_times_that_nobody_can_tell_are_refused(experiment, kind):
    rng = np.random.default_rng([3, *kind.encode()])
    n = experiment.n_frames
    if kind == "jitter":
        times = np.sort(np.arange(n) * PERIOD + 1e-3 * rng.standard_normal(n))
    else:
        times = np.cumsum(rng.uniform(0.006, 0.014, n))
    times = np.clip(times - times[0], 0, (n - 1) * PERIOD)
    with pytest.raises(SynchronisationError, match="--times"):
        experiment.timed(times, rng)


def test_a_film_before_an_uneven_ground_is_refused_with_the_remedy(experiment):
    """What pulls a marker at a place grows with its travel, as what jitter does to it grows with its speed."""
    rng = np.random.default_rng(8)
    stated = np.arange(experiment.n_frames) * PERIOD
    hub, _ = experiment.film(stated, rng)
    pulled = hub + 30e-6 * np.cos(hub / 1e-3)
    with pytest.raises(SynchronisationError, match="before an even ground"):
        time_film(experiment.hub_t, experiment.hub_x, stated, pulled, period_s=None)


def test_a_variable_rate_with_its_times_is_as_good_as_a_constant_one(experiment):
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.uniform(0.005, 0.014, experiment.n_frames - 60))
    found = experiment.timed(times - times[0], rng, period=None)
    wrong = found.synchronisation.hub_times(times - times[0]) - (times - times[0]) - experiment.begun
    assert np.abs(wrong).max() < LIMIT
    assert found.is_timed.all()


def test_a_clock_of_another_rate_is_no_loss(experiment):
    rng = np.random.default_rng(5)
    times = np.arange(experiment.n_frames - 3) * PERIOD * 1.002
    found = experiment.timed(times, rng)
    assert found.n_lost == 0
    assert found.synchronisation.drift == pytest.approx(2e-3, abs=5 * found.synchronisation.drift_sd + 2e-5)


def run(experiment: Experiment, seed: int) -> str:
    """One film of the two hundred: ok, refused or wrong."""
    rng = np.random.default_rng([6, seed])
    kind = ("one", "many", "bursts", "none", "jitter", "variable", "both")[seed % 7]
    times = dropped({"both": "many"}.get(kind, kind), experiment.n_frames, rng)
    if kind in ("jitter", "both"):
        times = times + 10 ** rng.uniform(-4.5, -2.5) * rng.standard_normal(len(times))
    if kind == "variable":
        times = np.cumsum(rng.uniform(0.006, 0.014, len(times)))
    times = np.clip(np.sort(times - times[0]), 0, (experiment.n_frames - 1) * PERIOD)
    try:
        found = experiment.timed(times, rng)
    except SynchronisationError:
        return "refused"
    error = experiment.error(found, times)
    # Jitter is no error of the clock: its rms is stated and refused above the same limit.
    is_right = (
        np.sqrt(np.mean(error**2)) < LIMIT if kind in ("jitter", "both") else np.abs(error).max() < LIMIT
    )
    return "ok" if is_right else "wrong"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1048, 1136, 2070, 2076, 2151])
def test_uneven_films_do_not_pass_for_films_that_lack_frames_nor_bursts_for_noise(experiment, seed):
    # Up to 128 ms wrong, where frames at rest told the noise, and a jitter that nobody could tell passed for none.
    assert run(experiment, seed) != "wrong"


@pytest.mark.verify
def test_of_two_hundred_films_none_is_wrong(experiment):
    # Seeds from a thousand on: nothing was tried out on them.
    outcomes = [run(experiment, seed) for seed in range(1000, 1200)]
    assert outcomes.count("wrong") == 0
    assert outcomes.count("ok") > 100
