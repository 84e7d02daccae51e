"""The device's clock on the host's: an affine map from round trips, that is slewed and never stepped.

In an exchange the host notes when it asks and when the answer is there, the device what its clock read in
between. The middle of the exchange is the host's time of that reading, wrong by at most half the round
trip; the part of the round trip beyond the shortest one seen bounds what queueing added, and weighs the
exchange. A robust weighted regression of the last exchanges gives offset and rate.

What all exchanges share, a way out that is longer than the way back, no method can see: it is a constant
of at most half the shortest round trip. It is stated apart from the rest, as ``asymmetry_sd_ns``: the rest
scatters from stamp to stamp and is what a gate can ask for, the constant is the same in all stamps and ends
in the latency that identification estimates. A stamp's own uncertainty counts both (``stamp_sd_ns``).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ros.arrays import FloatArray
from beam_ros.hub.contract import ClockSync

WINDOW_NS = 30_000_000_000
"""Exchanges older than this no longer count [ns]."""
MAX_EXCHANGES = 400
RATE_SD = 1e-4
"""What is known of the rate beforehand: crystals are within 100 ppm of their frequency."""
FLOOR_NS = 5_000.0
"""Error of the best exchanges: resolution of the clocks, time to wake up [ns, standard deviation]."""
SLEW_NS = 300_000_000
"""Device time within which the map joins a new estimate [ns]."""
MAX_SLEW = 5e-4
"""Greatest change of the map's rate while it does so."""
MIN_EXCHANGES = 10
RESOLUTION_NS = 1_000_000
"""A device may read a clock that advances in steps of so much [ns]."""
STRANGE_RATE = 1e-2
"""No clock is further off than this; of a crystal it is a hundred times what its maker promises."""
STRANGE_CHANGE = 2e-3
"""The rate of a clock that has been fitted is not further from the fit than this."""
COMPARED_NS = 1_000_000_000
"""A reading is held against the newest one and one that is older than this [ns]: what a resolution excuses from one
question to the next adds up over a second."""


@dataclass(frozen=True)
class ClockFit:
    """An affine map of device time to host time with its uncertainty.

    Parameters
    ----------
    device_reference_ns, host_reference_ns : int
        Where the fit is anchored [ns].
    rate : float
        Host nanoseconds per device nanosecond.
    offset_ns : float
        Host time at ``device_reference_ns``, from ``host_reference_ns`` on [ns].
    covariance : ndarray, shape (2, 2)
        Of offset [ns] and rate, as far as the exchanges differ.
    shortest_rtt_ns : int
        Shortest round trip [ns]: half of it bounds the constant that all exchanges may share.
    """

    device_reference_ns: int
    host_reference_ns: int
    rate: float
    offset_ns: float
    covariance: FloatArray
    shortest_rtt_ns: int = 0

    @property
    def asymmetry_sd_ns(self) -> float:
        """Standard deviation [ns] of the constant: uniform within half the shortest round trip."""
        return self.shortest_rtt_ns / math.sqrt(12.0)

    def host_ns(self, device_ns: int) -> int:
        """Return the host time [ns] of a device time [ns]."""
        elapsed_ns = device_ns - self.device_reference_ns
        correction = self.offset_ns + (self.rate - 1.0) * elapsed_ns
        return self.host_reference_ns + elapsed_ns + round(correction)

    def standard_deviation_ns(self, device_ns: int) -> float:
        """Return the standard deviation [ns] of ``host_ns`` at a device time, without the constant."""
        elapsed_ns = float(device_ns - self.device_reference_ns)
        c = self.covariance
        return math.sqrt(max(0.0, c[0, 0] + 2 * elapsed_ns * c[0, 1] + elapsed_ns**2 * c[1, 1]))

    def stamp_sd_ns(self, device_ns: int) -> float:
        """Return the standard deviation [ns] of ``host_ns`` at a device time, the constant included."""
        return math.hypot(self.standard_deviation_ns(device_ns), self.asymmetry_sd_ns)


def fit_affine(syncs: Sequence[ClockSync], *, rate_sd: float | None = None) -> ClockFit:
    """Return the map that clock comparisons of one epoch give; for use offline and by ``ClockMapping``.

    Parameters
    ----------
    syncs : sequence of ClockSync
        At least two, of one epoch, at different device times.
    rate_sd : float, optional
        Standard deviation of what is known beforehand of the rate (that it is 1); without it, nothing.

    Returns
    -------
    ClockFit
        Anchored at the last comparison.

    Raises
    ------
    ValueError
        Fewer than two comparisons, more than one epoch, or all at one device time.

    Notes
    -----
    Exchange i has the standard deviation sqrt(s0^2 + ((rtt_i - rtt_min)/2)^2 / 3): a uniform error within
    what queueing added. Residuals beyond 2 sd lose weight (Huber); the covariance grows by the reduced
    chi-squared where that exceeds 1.
    """
    epochs = {sync.epoch for sync in syncs}
    if len(syncs) < 2 or len(epochs) != 1:
        raise ValueError(
            f"{len(syncs)} clock comparisons of {len(epochs)} epochs: expected at least two of one epoch; "
            "fit each epoch by itself"
        )
    last = syncs[-1]
    # Differences are small: doubles hold them to a nanosecond.
    device = np.array([float(sync.device_ns - last.device_ns) for sync in syncs])
    host = np.array([float(sync.host_ns - last.host_ns) for sync in syncs])
    rtt = np.array([float(sync.rtt_ns) for sync in syncs])
    span = float(np.ptp(device))
    if span == 0.0:
        raise ValueError("all clock comparisons at one device time: expected different ones to fit a rate")
    sd = np.sqrt(FLOOR_NS**2 + (rtt - rtt.min()) ** 2 / 12.0)

    # Scaled unknowns: offset [s0], drift over the span [s0].
    design = np.column_stack([np.ones_like(device), device / span])
    target = host - device
    prior = np.zeros((2, 2))
    if rate_sd is not None:
        prior[1, 1] = 1.0 / (rate_sd * span) ** 2
    huber = np.ones_like(sd)
    for _ in range(5):
        weighted = design * (huber / sd**2)[:, None]
        covariance = np.linalg.inv(weighted.T @ design + prior)
        estimate = covariance @ (weighted.T @ target)
        normalised = np.abs(target - design @ estimate) / sd
        huber = np.minimum(1.0, 2.0 / np.maximum(normalised, 1e-12))
    freedom = max(1.0, float(huber.sum()) - 2.0)
    covariance = covariance * max(1.0, float(np.sum(huber * normalised**2)) / freedom)
    to_rate = np.diag([1.0, 1.0 / span])
    return ClockFit(
        last.device_ns,
        last.host_ns,
        1.0 + float(estimate[1]) / span,
        float(estimate[0]),
        to_rate @ covariance @ to_rate,
        int(rtt.min()),
    )


class ClockMapping:
    """The map of one epoch, kept up to date by exchanges.

    ``host_ns`` is continuous and strictly increasing, whatever the exchanges bring: from the newest device time
    that was mapped on, it turns towards the newest estimate.

    Parameters
    ----------
    epoch : int
        Counts the device's starts.
    """

    def __init__(self, epoch: int) -> None:
        self.epoch = epoch
        self._exchanges: deque[ClockSync] = deque(maxlen=MAX_EXCHANGES)
        # As they were fitted when each came: the present one may already follow what is to be judged by it.
        self._rates: deque[float | None] = deque(maxlen=MAX_EXCHANGES)
        self._shortest_rtt_ns = 0
        self._fit: ClockFit | None = None
        self._newest_mapped_ns: int | None = None
        # The published line: host = pivot_host + (device - pivot_device) * rate.
        self._pivot_device_ns = 0
        self._pivot_host_ns = 0.0
        self._pivot_base_ns = 0
        self._rate = 1.0

    @property
    def n_exchanges(self) -> int:
        """Exchanges of the present window."""
        return len(self._exchanges)

    @property
    def is_usable(self) -> bool:
        """Whether there are exchanges enough to map anything."""
        return self._fit is not None

    @property
    def rate(self) -> float:
        """Host seconds per device second, as estimated; 1 while there is no estimate."""
        return 1.0 if self._fit is None else self._fit.rate

    @property
    def shortest_rtt_ns(self) -> int:
        """Shortest round trip of the present window [ns]; 0 while there is none."""
        return self._shortest_rtt_ns

    def standard_deviation_ns(self, device_ns: int) -> float:
        """Return the standard deviation [ns] of the map at a device time, infinite without an estimate.

        Counts what exchanges leave open and how far the slewed map is from the estimate, not the constant
        that all exchanges share.
        """
        if self._fit is None:
            return math.inf
        lag_ns = self._published_ns(device_ns) - self._fit.host_ns(device_ns)
        return math.hypot(self._fit.standard_deviation_ns(device_ns), lag_ns)

    def stamp_sd_ns(self, device_ns: int) -> float:
        """Return the standard deviation [ns] of a stamp: that of the map and of the constant together."""
        if self._fit is None:
            return math.inf
        return math.hypot(self.standard_deviation_ns(device_ns), self._fit.asymmetry_sd_ns)

    def possible_ns(self, sent_ns: int, received_ns: int) -> tuple[int, int] | None:
        """Return least and greatest device time [ns] that an exchange can show, None without an earlier one.

        A device reads its clock between question and answer, in an earlier exchange and in this one: that
        bounds the time between the two readings, whatever the line did.
        """
        if not self._exchanges:
            return None
        newest = len(self._exchanges) - 1
        before_ns = sent_ns - COMPARED_NS
        older = next((k for k in range(newest, -1, -1) if self._exchanges[k].host_ns <= before_ns), newest)
        least, greatest = zip(
            *(self._possible_after(place, sent_ns, received_ns) for place in (newest, older)), strict=True
        )
        return max(least), min(greatest)

    def _possible_after(self, place: int, sent_ns: int, received_ns: int) -> tuple[int, int]:
        """Return what one earlier exchange leaves possible, by itself [ns of device time]."""
        known, fitted = self._exchanges[place], self._rates[place]
        shortest_ns = sent_ns - known.host_ns - known.rtt_ns / 2
        longest_ns = received_ns - known.host_ns + known.rtt_ns / 2
        rate, strange = (1.0, STRANGE_RATE) if fitted is None else (1.0 / fitted, STRANGE_CHANGE)
        slack_ns = RESOLUTION_NS + strange * max(abs(shortest_ns), abs(longest_ns))
        return (
            known.device_ns + round(shortest_ns * rate - slack_ns),
            known.device_ns + round(longest_ns * rate + slack_ns),
        )

    def add(self, sent_ns: int, received_ns: int, device_ns: int) -> ClockSync:
        """Take one exchange: host times of question and answer, and the device's clock in between [ns].

        One that cannot be true beside those before (``possible_ns``), or that came too late, changes nothing.
        """
        sync = ClockSync((sent_ns + received_ns) // 2, device_ns, self.epoch, max(0, received_ns - sent_ns))
        possible = self.possible_ns(sent_ns, received_ns)
        if possible is not None and not (
            possible[0] <= device_ns <= possible[1] and device_ns > self._exchanges[-1].device_ns
        ):
            return sync
        self._exchanges.append(sync)
        self._rates.append(None)
        while self._exchanges[0].device_ns < device_ns - WINDOW_NS:
            self._exchanges.popleft()
            self._rates.popleft()
        # Asked for a hundred times as often as an exchange comes.
        self._shortest_rtt_ns = min(exchange.rtt_ns for exchange in self._exchanges)
        if len(self._exchanges) >= MIN_EXCHANGES:
            self._turn_towards(fit_affine(list(self._exchanges), rate_sd=RATE_SD))
        self._rates[-1] = None if self._fit is None else self._fit.rate
        return sync

    def host_ns(self, device_ns: int) -> int:
        """Return the host time [ns] of a device time [ns]; to be asked in increasing order for stamps."""
        if self._newest_mapped_ns is None or device_ns > self._newest_mapped_ns:
            self._newest_mapped_ns = device_ns
        return self._published_ns(device_ns)

    def device_ns(self, host_ns: int) -> int:
        """Return the device time [ns] of a host time [ns]."""
        ahead = (host_ns - self._pivot_base_ns) - self._pivot_host_ns
        return self._pivot_device_ns + round(ahead / self._rate)

    def _published_ns(self, device_ns: int) -> int:
        elapsed_ns = device_ns - self._pivot_device_ns
        correction = self._pivot_host_ns + (self._rate - 1.0) * elapsed_ns
        return self._pivot_base_ns + elapsed_ns + round(correction)

    def _turn_towards(self, fit: ClockFit) -> None:
        """Let the published line join a new estimate; at first, while nothing was mapped, at once."""
        pivot_ns = self._newest_mapped_ns
        if self._fit is None or pivot_ns is None:
            self._pivot_device_ns = fit.device_reference_ns
            self._pivot_base_ns = fit.host_reference_ns
            self._pivot_host_ns = fit.offset_ns
            self._rate = fit.rate
        else:
            # Kept as a float beside a whole base, so that repeated turning does not round the line away.
            elapsed_ns = pivot_ns - self._pivot_device_ns
            here = self._pivot_host_ns + (self._rate - 1.0) * elapsed_ns
            self._pivot_base_ns += elapsed_ns
            self._pivot_device_ns = pivot_ns
            self._pivot_host_ns = here
            wanted = (
                (fit.host_reference_ns - self._pivot_base_ns)
                + fit.offset_ns
                + (pivot_ns - fit.device_reference_ns) * fit.rate
            )
            slew = (wanted - here) / SLEW_NS
            self._rate = fit.rate + min(max(slew, -MAX_SLEW), MAX_SLEW)
        self._fit = fit
