from __future__ import annotations

import numpy as np
import pytest

from beam_ros.hub.clock_mapping import FLOOR_NS, ClockMapping, fit_affine
from beam_ros.hub.contract import ClockSync

HOST_START = 8_000_000_000_000
DEVICE_START = 123_456_789_000


class Line:
    """A serial line with queueing, between a host and a device whose clock drifts."""

    def __init__(self, drift_ppm: float, seed: int, *, base_ns: int = 100_000, queue_ns: float = 60_000.0):
        self.rate = 1 + drift_ppm * 1e-6
        self.rng = np.random.default_rng(seed)
        self.base_ns, self.queue_ns = base_ns, queue_ns

    def device_ns(self, host_ns: int) -> int:
        return DEVICE_START + round((host_ns - HOST_START) * self.rate)

    def host_ns(self, device_ns: int) -> float:
        return HOST_START + (device_ns - DEVICE_START) / self.rate

    def exchange(self, host_ns: int) -> tuple[int, int, int]:
        out, back = (self.base_ns / 2 + self.rng.exponential(self.queue_ns, 2)).astype(int)
        if self.rng.random() < 0.03:
            out += int(self.rng.exponential(20e6))
        if self.rng.random() < 0.03:
            back += int(self.rng.exponential(20e6))
        return host_ns, int(host_ns + out + back), self.device_ns(int(host_ns + out))


def exchanges(line: Line, seconds: float, step_ns: int = 200_000_000):
    return [line.exchange(HOST_START + k * step_ns) for k in range(int(seconds * 1e9) // step_ns)]


@pytest.mark.slow
@pytest.mark.parametrize("drift_ppm", [-90.0, 35.0])
def test_offset_and_rate_come_out_within_their_standard_deviations(drift_ppm):
    scores = []
    for seed in range(25):
        line = Line(drift_ppm, seed)
        mapping = ClockMapping(1)
        for exchange in exchanges(line, 20.0):
            mapping.add(*exchange)
        device_ns = line.device_ns(HOST_START + 20 * 10**9)
        error = mapping.host_ns(device_ns) - line.host_ns(device_ns)
        scores.append(error / mapping.standard_deviation_ns(device_ns))
        assert mapping.rate == pytest.approx(1 / line.rate, abs=5e-6)
        assert mapping.standard_deviation_ns(device_ns) < 20_000
    # The stated deviation is honest: neither optimistic nor twice too large for the scatter of 25 runs.
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.4
    assert np.max(np.abs(scores)) < 4.0


def test_the_gate_of_fifty_microseconds_opens_within_half_a_second():
    line = Line(80.0, 3)
    mapping = ClockMapping(1)
    for exchange in exchanges(line, 0.5, 10_000_000):
        mapping.add(*exchange)
    device_ns = line.device_ns(HOST_START + 500_000_000)
    assert mapping.standard_deviation_ns(device_ns) < 50_000
    assert abs(mapping.host_ns(device_ns) - line.host_ns(device_ns)) < 150_000


def test_a_short_look_at_the_clock_does_not_claim_to_know_it_far_ahead():
    line = Line(80.0, 5)
    mapping = ClockMapping(1)
    for exchange in exchanges(line, 0.2, 10_000_000):
        mapping.add(*exchange)
    later = line.device_ns(HOST_START + 10 * 10**9)
    # The rate is known to 1e-4 beforehand: 10 s ahead that is a millisecond.
    assert mapping.standard_deviation_ns(later) > 300_000


def test_nothing_is_mapped_before_there_are_exchanges():
    mapping = ClockMapping(1)
    assert not mapping.is_usable
    assert mapping.standard_deviation_ns(0) == np.inf


@pytest.mark.parametrize("seed", range(5))
def test_stamps_increase_and_never_step_whatever_the_exchanges_say(seed):
    line = Line(50.0, seed, queue_ns=400_000.0)
    mapping = ClockMapping(1)
    for exchange in exchanges(line, 0.3, 10_000_000):
        mapping.add(*exchange)
    stamps = []
    for k in range(3000):
        now = HOST_START + 300_000_000 + k * 20_000_000
        if k % 10 == 0:
            sent, received, device = line.exchange(now)
            # The line changes its character: a hub in between adds 2 ms one way, from the middle on.
            mapping.add(sent, received + (2_000_000 if k > 1500 else 0), device)
        stamps.append(mapping.host_ns(line.device_ns(now) // 1_000_000 * 1_000_000))
    gaps = np.diff(stamps)
    # Device ticks are 20 ms apart, now and then 21: the map may bend that by 0.06 % at the most.
    assert np.all(np.abs(gaps - np.round(gaps / 1e6) * 1e6) < 21e6 * 6e-4)
    assert np.all(gaps > 0)


def test_host_and_device_times_are_inverses():
    line = Line(-60.0, 2)
    mapping = ClockMapping(1)
    for k, exchange in enumerate(exchanges(line, 5.0)):
        mapping.add(*exchange)
        if mapping.is_usable:
            mapping.host_ns(line.device_ns(HOST_START + k * 200_000_000))
    for ahead in (-3 * 10**9, 0, 7 * 10**9):
        device_ns = line.device_ns(HOST_START + 5 * 10**9) + ahead
        assert abs(mapping.device_ns(mapping.host_ns(device_ns)) - device_ns) <= 1


def test_an_exchange_out_of_order_changes_nothing():
    line = Line(0.0, 1)
    mapping = ClockMapping(1)
    rows = exchanges(line, 3.0)
    for row in rows:
        mapping.add(*row)
    before = mapping.host_ns(DEVICE_START)
    mapping.add(*rows[2])
    assert mapping.host_ns(DEVICE_START) == before


def test_the_offline_fit_redoes_the_map_from_recorded_comparisons():
    line = Line(35.0, 9)
    syncs = []
    for sent, received, device in exchanges(line, 60.0):
        syncs.append(ClockSync((sent + received) // 2, device, 1, received - sent))
    fit = fit_affine(syncs)
    for host_ns in (HOST_START, HOST_START + 30 * 10**9, HOST_START + 60 * 10**9):
        device_ns = line.device_ns(host_ns)
        sd = fit.standard_deviation_ns(device_ns)
        assert sd < 15_000
        assert abs(fit.host_ns(device_ns) - line.host_ns(device_ns)) < 4 * sd
    assert abs(fit.rate - 1 / line.rate) < 4 * np.sqrt(fit.covariance[1, 1])
    assert fit.covariance.shape == (2, 2)


def test_gross_outliers_do_not_pull_the_fit():
    line = Line(0.0, 4, queue_ns=10_000.0)
    syncs = [ClockSync((s + r) // 2, d, 1, r - s) for s, r, d in exchanges(line, 20.0)]
    broken = list(syncs)
    # A wrong device reading with an innocent round trip: what a confused reply would do.
    broken[40] = ClockSync(syncs[40].host_ns + 5_000_000, syncs[40].device_ns, 1, syncs[40].rtt_ns)
    device_ns = syncs[-1].device_ns
    assert abs(fit_affine(broken).host_ns(device_ns) - fit_affine(syncs).host_ns(device_ns)) < 10_000


def test_a_fit_without_enough_to_fit_is_refused():
    one = ClockSync(1, 1, 1, 10)
    for syncs in ([one], [one, one], [one, ClockSync(5, 5, 2, 10)]):
        with pytest.raises(ValueError, match="clock comparisons"):
            fit_affine(syncs)


def test_an_outlier_pulls_like_two_deviations_and_no_more():
    # Huber's psi of 2 sd: n comparisons at zero and one far off balance at 2 sd/n, wherever the outlier lies.
    n, far_ns = 40, 3_000_000
    syncs = [
        ClockSync(HOST_START + k * 10**8, DEVICE_START + k * 10**8, 1, 0) for k in range(-n // 2, n // 2 + 1)
    ]
    middle = n // 2
    syncs[middle] = ClockSync(syncs[middle].host_ns + far_ns, syncs[middle].device_ns, 1, 0)
    found = fit_affine(syncs, rate_sd=1e-12)
    at_middle = found.host_ns(syncs[middle].device_ns) - HOST_START
    assert at_middle == pytest.approx(2.0 * FLOOR_NS / n, rel=0.05)


def test_what_the_round_trip_cannot_exclude_is_stated_beside_the_rest():
    # The way back takes 0.3 ms longer, in every exchange: a constant that no fit can see.
    line = Line(35.0, 9, base_ns=0, queue_ns=10_000.0)
    syncs = []
    for sent, received, device in exchanges(line, 60.0):
        syncs.append(ClockSync((sent + received + 300_000) // 2, device, 1, received - sent + 300_000))
    fit = fit_affine(syncs)
    device_ns = line.device_ns(HOST_START + 30 * 10**9)
    error = fit.host_ns(device_ns) - line.host_ns(device_ns)
    assert error == pytest.approx(150_000, abs=5_000)
    assert fit.standard_deviation_ns(device_ns) < 2_000
    # Uniform within half the shortest round trip.
    assert fit.asymmetry_sd_ns == pytest.approx(min(sync.rtt_ns for sync in syncs) / np.sqrt(12), rel=1e-12)
    assert error < 1.96 * fit.stamp_sd_ns(device_ns) < 200_000
    # The rate, which both ends share, is as well known as before.
    assert np.sqrt(fit.covariance[1, 1]) < 1e-7


@pytest.mark.parametrize("absurd", [1 << 62, DEVICE_START - 10**10, DEVICE_START + 10**10])
def test_one_absurd_reading_does_not_blind_the_rest(absurd):
    line = Line(35.0, 6)
    mapping = ClockMapping(1)
    rows = exchanges(line, 20.0)
    for row in rows[:20]:
        mapping.add(*row)
    sent, received, _ = rows[20]
    mapping.add(sent, received, absurd)
    for row in rows[21:]:
        mapping.add(*row)
    device_ns = line.device_ns(HOST_START + 20 * 10**9)
    assert abs(mapping.host_ns(device_ns) - line.host_ns(device_ns)) < 40_000
    assert mapping.standard_deviation_ns(device_ns) < 20_000


def test_what_an_exchange_can_show_is_bounded_by_the_one_before():
    mapping = ClockMapping(1)
    assert mapping.possible_ns(0, 10) is None
    mapping.add(HOST_START, HOST_START + 200_000, DEVICE_START)
    least, greatest = mapping.possible_ns(HOST_START + 10**8, HOST_START + 10**8 + 300_000)
    # 0.1 s later, less one way or more two: 99.8 to 100.3 ms, a millisecond and one per cent.
    assert least == pytest.approx(DEVICE_START + 97_797_000, abs=5_000)
    assert greatest == pytest.approx(DEVICE_START + 102_303_000, abs=5_000)


def outside(line: Line, ppm_later: float, step_ns: int, *, seconds: float = 3.0) -> int | None:
    """Return after what time [ns] with a clock that runs faster an exchange was not possible; None: never."""
    mapping = ClockMapping(1)
    turn_ns = HOST_START + 2 * 10**9
    for k in range(round((2.0 + seconds) * 1e9) // step_ns):
        sent, received, device_ns = line.exchange(HOST_START + k * step_ns)
        device_ns += round(max(0, sent - turn_ns) * ppm_later * 1e-6)
        possible = mapping.possible_ns(sent, received)
        if possible is not None and not possible[0] <= device_ns <= possible[1]:
            return sent - turn_ns
        mapping.add(sent, received, device_ns)
    return None


@pytest.mark.parametrize("step_ns", [10_000_000, 40_000_000, 200_000_000])
@pytest.mark.parametrize("ppm", [-10_000, 10_000])
def test_a_clock_that_drifts_by_a_hundredth_is_noticed_however_often_it_is_asked(ppm, step_ns):
    # 1 ms of resolution, 2 ms for a rate that may be wrong over a second, and what a round trip leaves open.
    for seed in range(3):
        noticed_ns = outside(Line(35.0, seed), ppm, step_ns)
        assert noticed_ns is not None
        assert 0 < noticed_ns < 800_000_000


@pytest.mark.slow
@pytest.mark.parametrize("step_ns", [10_000_000, 40_000_000, 200_000_000])
@pytest.mark.parametrize("ppm", [-1000, 1000])
def test_no_crystal_slewed_host_or_hiccup_is_taken_for_a_clock_that_is_wrong(ppm, step_ns):
    # Crystals, and a host whose time service turns its clock by 500 ppm: together less than 1000 ppm. The
    # line's hiccups of tens of milliseconds, and long ways, leave more open, never less.
    for base_ns in (100_000, 50_000_000):
        assert outside(Line(60.0, 3, base_ns=base_ns), ppm, step_ns, seconds=6.0) is None
