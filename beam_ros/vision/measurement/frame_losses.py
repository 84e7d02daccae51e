"""Which frames a film lacks, as the hub tells: a camera that drops frames leaves a file that does not say so.

The frame with number k was taken at the period k + n_k of the camera's clock, and n_k, the frames lost so far, only
grows. The film shows the hub's position x_k; the hub's own record alpha(t) is known. The most likely n is the
cheapest path through

    sum_k (x_k - gain alpha(offset + (1 + drift)(k + n_k) period) - zero)^2 / (2 sigma^2)  +  losses * toll

(Viterbi 1967), in turns with offset, drift, gain and zero by least squares (``synchronisation``). Forward and
backward sums over all paths say in which frames n_k is certain. Where the hub rests it tells nothing; there the free
swing of the beam does: it obeys a linear recursion, which a lost frame breaks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from beam_ros.arrays import FloatArray, IndexArray
from beam_ros.vision.errors import SynchronisationError
from beam_ros.vision.measurement.synchronisation import Synchronisation, directions, synchronise

_TOLL = 16.0
"""What a loss costs: it must explain the film better by so much, in units of log-likelihood."""
_CAP = 25.0
"""A single frame costs no more than this, however wrong it is."""
_MAX_SHARE = 0.35
"""Largest share of lost frames that is looked for."""
_MAX_LOST = 400
_CERTAIN = 1e-3
"""A frame's place is certain where all other places together have at most this probability."""
_DOUBT = 2.0
"""What no model holds (the beam's own bending, the hub between its samples) may be as large as the noise."""
_MIN_TELLING = 6
_MOVING, _MIN_MOVING = 3.0, 40
"""Frames between which the marker moves by so many standard deviations, and how many of them are needed."""
_TURNS = 6
_GROWTH_TURNS = 12
_WINDOW_S = 0.6
_GOOD_CORRELATION = 0.97
_LARGEST_TIMING_S = 0.2e-3
_SIGNIFICANT = 5.0
_SOME, _LIKELY = 0.6, 3.0
"""Jitter is refused from this share of the limit on where it is significant, from the limit on where it is likely."""
_EVEN = 0.1
"""Share of a period by which frames may be shown to be uneven where some are taken for lost."""
_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian noise over its median absolute deviation."""
_RECURSION = 6
_BROKEN = 9.0
"""So many standard deviations of its innovations break the recursion of a free swing, ..."""
_SUDDEN = 4.0
"""... and so many times what they have been of late: a mode that nearly nothing excites elsewhere grows slowly."""


@dataclass(frozen=True)
class FilmTimes:
    """When the frames of a film were taken, by the hub's clock.

    Attributes
    ----------
    synchronisation : Synchronisation -- between the camera's times, lost frames counted in, and the hub's
    lost : ndarray of int, shape (n_frames,) -- frames lost before each frame
    is_timed : ndarray of bool, shape (n_frames,) -- False: nobody knows when this frame was taken
    time_sd_s : float -- standard deviation of the first or the last frame's time, the larger: of offset and drift [s]
    jitter_s, jitter_sd_s : float -- irregularity of the frame times, standard deviation [s], and how well it is known
    """

    synchronisation: Synchronisation
    lost: IndexArray
    is_timed: np.ndarray
    time_sd_s: float
    jitter_s: float
    jitter_sd_s: float

    @property
    def n_lost(self) -> int:
        """Frames lost between the first and the last."""
        return int(self.lost[-1] - self.lost[0])


def time_film(
    hub_times_s: FloatArray,
    hub_positions_m: FloatArray,
    camera_times_s: FloatArray,
    seen_hub_m: FloatArray,
    *,
    period_s: float | None,
    high_markers_m: FloatArray | None = None,
    fits_drift: bool = True,
    fits_lag: bool = False,
) -> FilmTimes:
    """Find when every frame of a film was taken.

    Parameters
    ----------
    hub_times_s, hub_positions_m : ndarray, shape (n_hub,) -- the hub's record
    camera_times_s : ndarray, shape (n_frames,) -- times that the film states, rising [s]
    seen_hub_m : ndarray, shape (n_frames,) -- the hub's position as the film shows it [m]; NaN where not seen
    period_s : float or None -- time between frames, of which whole multiples may be missing; None: the times are the
        camera's own, one for each frame, and only judged
    high_markers_m : ndarray, shape (n_frames, n), optional -- displacements that swing when the hub rests [m]
    fits_drift : bool -- also fit the ratio of the clocks' rates
    fits_lag : bool -- also fit by how much the film stays behind, as behind a codec that keeps what changes

    Returns
    -------
    FilmTimes

    Raises
    ------
    SynchronisationError
        The records do not resemble each other, or frames come at times that nobody can tell.
    """
    search = _Search(hub_times_s, hub_positions_m, camera_times_s, seen_hub_m, period_s, fits_drift, fits_lag)
    found, lost = search.best()
    times = camera_times_s + lost * (period_s or 0.0)
    # Frames beside a loss may still be misplaced, which looks like jitter: they are left out first.
    jitter, jitter_sd = search.judge(found, times, heeds_jitter=not np.any(lost))
    is_timed = np.ones(len(times), dtype=bool)
    if period_s is not None:
        is_timed = search.certain(found, lost)
        if np.any(lost):
            is_timed &= _well_placed(lost, is_timed & search.is_moving(found, times))
            # Frames whose place is doubtful pull at the clock.
            search.seen = np.where(is_timed, search.seen, np.nan)
            if np.count_nonzero(np.isfinite(search.seen)) < _MIN_MOVING:
                raise _uneven(period_s, math.inf)
            found = search.fit(times)
            jitter, jitter_sd = search.judge(found, times)
        if high_markers_m is not None:
            instants = found.hub_times(times)[:, None] - period_s * np.arange(4 * _RECURSION + 1) / 4
            hub = np.interp(instants, hub_times_s, hub_positions_m)
            moving = search.is_moving(found, times)
            told = np.rint((camera_times_s - camera_times_s[0]) / period_s).astype(np.intp)
            missing = lost + told - np.arange(len(told))
            is_timed = _as_the_swing_tells(is_timed, lost, missing, moving, high_markers_m, hub)
        # Frames that nobody can time are there only where some are lost, whether they were found or not.
        largest = _largest(jitter, jitter_sd) if np.any(is_timed) else math.inf
        if (np.any(lost) or not np.all(is_timed)) and largest > _EVEN * period_s:
            raise _uneven(period_s, largest)
    time_sd = float(np.max(found.hub_time_sds(times[[0, -1]])))
    return FilmTimes(found, lost, is_timed, time_sd, jitter, jitter_sd)


def _largest(jitter_s: float, sd_s: float) -> float:
    """Jitter that two standard deviations of its square leave possible [s]; ``sd_s`` as ``judge`` returns it."""
    slope_sd = 2.0 * jitter_s * sd_s if jitter_s > 0 else sd_s**2
    return math.sqrt(jitter_s**2 + 2.0 * slope_sd)


def _uneven(period_s: float, largest_s: float) -> SynchronisationError:
    """Say that nobody can tell lost frames from frames that come unevenly."""
    by = f"by {largest_s * 1e3:.2g} ms" if math.isfinite(largest_s) else "by any time"
    return SynchronisationError(
        f"the film lacks frames, or its frames come unevenly {by}, and the hub's motion does not tell which; "
        f"expected them even to {_EVEN * period_s * 1e3:.2g} ms: give the camera's own times with --times, or film "
        "at a constant rate"
    )


class _Search:
    """The hub's record and the film's, and the paths between them."""

    def __init__(
        self,
        hub_t: FloatArray,
        hub_x: FloatArray,
        times: FloatArray,
        seen: FloatArray,
        period_s: float | None,
        fits_drift: bool,
        fits_lag: bool,
    ) -> None:
        self.hub_t, self.hub_x, self.times, self.seen = hub_t, hub_x, times, seen
        self.period_s, self.fits_drift, self.fits_lag = period_s, fits_drift, fits_lag
        self.largest_speed = float(np.max(np.abs(np.gradient(hub_x, hub_t)), initial=0.0))
        self.sigma = 0.0
        self.n_states = 1 + min(math.ceil(_MAX_SHARE / (1 - _MAX_SHARE) * len(times)), _MAX_LOST)

    def fit(
        self, times: FloatArray, chosen: slice = slice(None), *, drift: bool | None = None
    ) -> Synchronisation:
        return synchronise(
            self.hub_t,
            self.hub_x,
            times[chosen],
            self.seen[chosen],
            fits_drift=self.fits_drift if drift is None else drift,
            fits_lag=self.fits_lag,
        )

    def residuals(self, found: Synchronisation, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Differences between film and hub [m], NaN where one is missing, and the hub's speed then [m/s]."""
        at = found.hub_times(times)
        inside = (at >= self.hub_t[0]) & (at <= self.hub_t[-1])
        hub = np.interp(at, self.hub_t, self.hub_x)
        speed = self._hub_speed(at)
        behind = found.lag_m * directions(speed, self.largest_speed) if found.lag_m else 0.0
        residual = np.where(inside, self.seen - found.gain * hub - found.zero_m + behind, np.nan)
        return residual, found.gain * speed

    def _hub_speed(self, at: FloatArray) -> FloatArray:
        """The hub's speed at times of its own [m/s]."""
        return np.interp(at, self.hub_t, np.gradient(self.hub_x, self.hub_t))

    def is_moving(self, found: Synchronisation, times: FloatArray) -> np.ndarray:
        """Whether the hub moves by more than the film's noise within a period."""
        speed = self._hub_speed(found.hub_times(times))
        return np.asarray(np.abs(speed) * (self.period_s or 0.0) > _MOVING * max(self.sigma, 1e-9))

    # -- the best path -------------------------------------------------------------------------------------

    def best(self) -> tuple[Synchronisation, IndexArray]:
        """Cheapest explanation of the film: without losses, or with."""
        none = np.zeros(len(self.times), dtype=np.intp)
        candidates: list[tuple[Synchronisation, IndexArray]] = []
        refusal: SynchronisationError | None = None
        try:
            candidates.append((self.fit(self.times), none))
        except SynchronisationError as err:
            refusal = err
        if self.period_s is not None:
            starts = [(len(self.times) // 2, candidates[0][0])] if candidates else []
            if not candidates or not self._agrees(candidates[0][0]):
                starts += self._starts()
            candidates += [path for start in starts if (path := self._followed(start)) is not None]
        if not candidates:
            raise refusal or SynchronisationError("the film cannot be laid over the hub's record")
        spreads = []
        for found, lost in candidates:
            residual, _ = self.residuals(found, self.times + lost * (self.period_s or 0.0))
            spreads.append(_spread(residual))
        self.sigma = max(min(spreads), 1e-7)
        costs = [self._cost(*candidate) for candidate in candidates]
        found, lost = candidates[int(np.argmin(costs))]
        # Frames at rest, which may be most of them, do not tell how well one in motion is explained.
        residual, speed = self.residuals(found, self.times + lost * (self.period_s or 0.0))
        self.sigma = max(self.sigma, _spread(residual[np.abs(speed) >= math.sqrt(np.mean(speed**2))]))
        return found, lost

    def _agrees(self, found: Synchronisation) -> bool:
        """Whether the film needs no losses: its frames are shown to be where it says, and even."""
        try:
            jitter = self.judge(found, self.times)
        except SynchronisationError:
            return False
        return _largest(*jitter) <= _EVEN * (self.period_s or math.inf)

    def _cost(self, found: Synchronisation, lost: IndexArray) -> float:
        residual, _ = self.residuals(found, self.times + lost * (self.period_s or 0.0))
        # A frame outside of the hub's record is not explained.
        single = np.where(np.isfinite(self.seen), np.minimum(0.5 * (residual / self.sigma) ** 2, _CAP), 0.0)
        single = np.where(np.isnan(single), _CAP, single)
        return float(np.sum(single)) + _TOLL * float(np.count_nonzero(np.diff(lost)))

    def _starts(self) -> list[tuple[int, Synchronisation]]:
        """Windows whose motion is the hub's at a place, the best first: frame and fit."""
        assert self.period_s is not None
        size = max(24, round(_WINDOW_S / self.period_s))
        whole = np.nanmax(self.seen) - np.nanmin(self.seen)
        found: list[tuple[float, int, Synchronisation]] = []
        for first in range(0, max(1, len(self.times) - size // 2), size // 3):
            part = slice(first, min(first + size, len(self.times)))
            values = self.seen[part]
            if (
                np.count_nonzero(np.isfinite(values)) < 20
                or np.nanmax(values) - np.nanmin(values) < 0.15 * whole
            ):
                continue
            try:
                fit = self.fit(self.times, part, drift=False)
            except SynchronisationError:
                continue
            if fit.correlation > _GOOD_CORRELATION and abs(fit.gain - 1) < 0.2:
                found.append((fit.residual_rms_m / float(np.nanstd(values)), first + size // 2, fit))
        found.sort(key=lambda one: one[0])
        return [(middle, fit) for _, middle, fit in found[:4]]

    def _followed(self, start: tuple[int, Synchronisation]) -> tuple[Synchronisation, IndexArray] | None:
        """Path from a window outwards, in turns with the fit."""
        assert self.period_s is not None
        middle, found = start
        middle = min(middle, len(self.times) - 1)
        lost: IndexArray | None = None
        sigma = max(found.residual_rms_m, 1e-7)
        for _ in range(_TURNS):
            costs = self._costs(found, sigma)
            after = _cheapest(costs[middle:, self.n_states - 1 :])
            before = _cheapest(costs[middle::-1, self.n_states - 1 :: -1])
            path = np.concatenate([-before[::-1], after[1:]])
            shift = path[0]
            path = path - shift
            if lost is not None and np.array_equal(path, lost):
                break
            lost = path
            try:
                found = self.fit(self.times + lost * self.period_s)
            except SynchronisationError:
                return None
            residual, _ = self.residuals(found, self.times + lost * self.period_s)
            sigma = max(_spread(residual), 1e-7)
            # The path is counted from the first frame, the states from the window's.
            found = found.begun_earlier(int(lost[middle]) * self.period_s)
        if lost is None:
            return None
        return found.begun_earlier(-int(lost[middle]) * self.period_s), lost

    def _costs(self, found: Synchronisation, sigma: float) -> FloatArray:
        """Cost of every frame at every number of lost frames, shape (n_frames, 2 n_states - 1)."""
        assert self.period_s is not None
        states = np.arange(-(self.n_states - 1), self.n_states)
        at = found.hub_times(self.times[:, None] + states * self.period_s)
        hub = np.interp(at, self.hub_t, self.hub_x)
        cost = np.minimum(0.5 * ((self.seen[:, None] - found.gain * hub - found.zero_m) / sigma) ** 2, _CAP)
        cost[(at < self.hub_t[0]) | (at > self.hub_t[-1])] = _CAP
        cost[~np.isfinite(self.seen)] = 0.0
        return np.asarray(cost)

    # -- what is certain -----------------------------------------------------------------------------------

    def certain(self, found: Synchronisation, lost: IndexArray) -> np.ndarray:
        """Whether all other numbers of lost frames are improbable, frame by frame."""
        assert self.period_s is not None
        n_more = 3
        top = int(lost[-1]) + n_more + 1
        at = found.hub_times(self.times[:, None] + np.arange(-n_more, top) * self.period_s)
        hub = np.interp(at, self.hub_t, self.hub_x)
        cost = np.minimum(
            0.5 * ((self.seen[:, None] - found.gain * hub - found.zero_m) / (_DOUBT * self.sigma)) ** 2, _CAP
        )
        cost[~np.isfinite(self.seen)] = 0.0
        losses = int(np.count_nonzero(np.diff(lost)))
        share = max(losses / len(lost), 1e-9)
        stay, step = math.log1p(-share), math.log(share / 2)
        forward, backward = _sums(-cost, stay, step), _sums(-cost[::-1, ::-1], stay, step)[::-1, ::-1]
        total = forward + backward + cost
        total -= total.max(axis=1, keepdims=True)
        weight = np.exp(total)
        weight /= weight.sum(axis=1, keepdims=True)
        chosen = weight[np.arange(len(lost)), lost + n_more]
        return np.asarray(1.0 - chosen <= _CERTAIN)

    def judge(
        self, found: Synchronisation, times: FloatArray, *, heeds_jitter: bool = True
    ) -> tuple[float, float]:
        """Refuse times that the hub contradicts; returns the jitter and its standard deviation [s]."""
        residual, speed = self.residuals(found, times)
        used = np.isfinite(residual)
        r, v = residual[used], speed[used]
        limit = _LARGEST_TIMING_S
        quiet = _spread(r[np.abs(v) <= np.quantile(np.abs(v), 0.4)])
        size = max(12, round(0.4 / float(np.median(np.diff(times)))))
        for first in range(0, len(r) - size // 2, size // 2):
            own_r, own_v = r[first : first + size], v[first : first + size]
            power = float(np.sum(own_v**2))
            if power <= 0:
                continue
            shift = float(np.sum(own_v * own_r)) / power
            noise = max(_spread(own_r - shift * own_v), quiet)
            sd = 2.0 * noise / math.sqrt(power)
            if abs(shift) > limit + _SIGNIFICANT * sd:
                raise SynchronisationError(
                    f"about {times[used][first] - times[0]:.2f} s into the film its frames come "
                    f"{shift * 1e3:+.2f} ms off the hub's clock; expected {limit * 1e3:g} ms at most: its frame "
                    "times are not right and cannot be mended, or its codec (H.264, H.265) or the camera's noise "
                    "reduction shows slow motion late; give the camera's own times with --times, film at a constant "
                    "rate, or with less compression and no noise reduction"
                )
        # r = -v delta + noise: what the squares gain with the speed is the jitter's variance.
        # A marker at rest shows one and the same error of its place among the pixels, one that moves shows all of
        # them: only frames in motion are compared with each other.
        moves = np.abs(v) * float(np.median(np.diff(times))) > _MOVING * _spread(r)
        if np.count_nonzero(moves) >= _MIN_MOVING:
            r, v = r[moves], v[moves]
        slope, slope_sd = _growth(r**2, v**2)
        jitter = math.sqrt(slope)
        jitter_sd = slope_sd / (2 * jitter) if jitter > 0 else math.sqrt(slope_sd)
        is_some = jitter > _SOME * limit and slope > _SIGNIFICANT * slope_sd
        if heeds_jitter and (is_some or (jitter > limit and slope > _LIKELY * slope_sd)):
            raise SynchronisationError(
                f"the film's frames come {jitter * 1e3:.2f} +- {jitter_sd * 1e3:.2f} ms (rms) off the times that "
                "it states, or an uneven ground behind the markers pulls them as they travel; expected "
                f"{limit * 1e3:g} ms at most: give the camera's own times with --times, film at a constant rate, or "
                "before an even ground"
            )
        return jitter, jitter_sd


def _spread(residual: FloatArray) -> float:
    """Robust standard deviation, infinite where nothing is known."""
    known = residual[np.isfinite(residual)]
    return float(_spread_of_sizes(np.abs(known - np.median(known)))) if known.size else math.inf


def _spread_of_sizes(sizes: FloatArray) -> FloatArray:
    """Robust standard deviation of what is so far from its middle, along the last axis; NaN is left out."""
    return np.asarray(_TO_SIGMA * np.nanmedian(sizes, axis=-1))


def _growth(squares: FloatArray, speeds: FloatArray) -> tuple[float, float]:
    """Growth of squared residuals with the squared speed, at least 0 [s^2], and its standard deviation.

    Their variance is twice the square of their mean, by which they are weighed in turns; what is beyond three
    standard deviations of a residual counts as much as that.
    """
    design = np.stack([np.ones_like(speeds), speeds], axis=1)
    found = np.array([float(np.mean(squares)), 0.0])
    for _ in range(_GROWTH_TURNS):
        mean = np.maximum(design @ found, 1e-3 * float(np.mean(squares)))
        weighted = design / mean[:, None] ** 2
        normal = weighted.T @ design
        found = np.maximum(np.linalg.pinv(normal) @ (weighted.T @ np.minimum(squares, 9.0 * mean)), 0.0)
    inverse = np.linalg.pinv(normal)
    left = np.minimum(squares, 9.0 * mean) - mean
    scatter = inverse @ ((weighted * left[:, None] ** 2).T @ weighted) @ inverse
    return float(found[1]), math.sqrt(max(2.0 * float(inverse[1, 1]), float(scatter[1, 1])))


def _cheapest(costs: FloatArray) -> IndexArray:
    """Cheapest path that never falls and begins at state 0; a rise costs the toll.

    Parameters
    ----------
    costs : ndarray, shape (n_frames, n_states)
    """
    n_frames, n_states = costs.shape
    total = np.full(n_states, np.inf)
    total[0] = costs[0, 0]
    came = np.zeros((n_frames, n_states), dtype=np.intp)
    states = np.arange(n_states)
    for k in range(1, n_frames):
        lowest = np.minimum.accumulate(total)
        # Where the running minimum is new, it is the state's own.
        where = np.maximum.accumulate(np.where(total <= lowest, states, 0))
        risen = np.concatenate([[np.inf], lowest[:-1] + _TOLL])
        is_risen = risen < total
        came[k] = np.where(is_risen, np.concatenate([[0], where[:-1]]), states)
        total = np.where(is_risen, risen, total) + costs[k]
    path = np.empty(n_frames, dtype=np.intp)
    path[-1] = int(np.argmin(total))
    for k in range(n_frames - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path


def _sums(log_likelihood: FloatArray, stay: float, step: float) -> FloatArray:
    """Logarithms of the sums over all paths that end in every state; a rise by j has the weight step - j ln 2."""
    n_frames, n_states = log_likelihood.shape
    total = np.empty_like(log_likelihood)
    total[0] = log_likelihood[0]
    falloff = -math.log(2.0) * np.arange(n_states)
    for k in range(1, n_frames):
        last = total[k - 1]
        risen = np.logaddexp.accumulate(last - falloff) + falloff
        risen = np.concatenate([[-np.inf], risen[:-1]]) + step
        total[k] = np.logaddexp(last + stay, risen) + log_likelihood[k]
    return total


def _well_placed(lost: IndexArray, tells: np.ndarray) -> np.ndarray:
    """Whether enough frames tell the place of all those between two losses: a few may agree by chance."""
    _, stretch = np.unique(lost, return_inverse=True)
    return np.asarray((np.bincount(stretch, weights=tells) >= _MIN_TELLING)[stretch])


def _as_the_swing_tells(
    is_timed: np.ndarray,
    lost: IndexArray,
    missing: IndexArray,
    is_moving: np.ndarray,
    high: FloatArray,
    hub: FloatArray,
) -> np.ndarray:
    """Judge the stretches in which the hub rests by the beam's swing.

    Frames after a broken recursion are not timed until the hub tells again. Where a swing is large enough to break
    and does not, frames are timed although the hub does not tell, if those before or behind them are. ``missing``
    counts the frames that are lost or, as the film itself tells, not there before each frame.
    """
    judged = is_timed.copy()
    has_losses = bool(np.any(np.diff(lost)))
    broken, silent = _breaks(high, hub, missing, is_timed)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], is_moving, [True]]).astype(int)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        own = np.flatnonzero(broken[first:last])
        if own.size:
            judged[max(0, first + int(own[0]) - 1) : last] = False
        before, behind = first - 1, min(last, len(lost) - 1)
        is_held = (before >= 0 and is_timed[before]) or (first == 0 and is_timed[behind])
        if has_losses and is_held and not own.size and lost[max(before, 0)] == lost[behind]:
            sound = ~silent[first:last]
            # From the known end on, as far as the swing can be heard without a pause.
            heard = np.logical_and.accumulate(sound if before >= 0 else sound[::-1])
            judged[first:last] |= heard if before >= 0 else heard[::-1]
    return np.asarray(judged)


def _usual_of_late(sizes: FloatArray) -> FloatArray:
    """Return the robust standard deviation before every value, 0 where no more than half of the last are known."""
    before = np.concatenate([np.full(4 * _RECURSION, np.nan), sizes[:-1]])
    last = sliding_window_view(before, 4 * _RECURSION)
    enough = 2 * np.count_nonzero(np.isfinite(last), axis=1) > last.shape[1]
    usual = np.zeros(len(sizes))
    usual[enough] = _spread_of_sizes(last[enough])
    return usual


def _breaks(
    high: FloatArray, hub: FloatArray, missing: IndexArray, is_timed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Frames that break the recursion of the driven beam, and frames in which a lost one would not be noticed.

    A deflection obeys w_k = sum a_i w_{k-i} + what the hub did in between, which is linear in the hub's positions at
    some instants of the last periods.

    Parameters
    ----------
    high : ndarray, shape (n_frames, n) -- displacements [m]
    hub : ndarray, shape (n_frames, n_instants) -- the hub's positions in the periods before each frame [m]
    missing, is_timed -- of every frame; lags count periods only where as many are missing
    """
    n, order = len(high), _RECURSION
    broken, silent = np.zeros(n, dtype=bool), np.ones(n, dtype=bool)
    deflection = high - hub[:, :1]
    lagged = [deflection[order - lag : n - lag] for lag in range(1, order + 1)]
    driven = (hub[order:, 1:] - hub[order:, :1])[:, :, None]
    together = missing[order:] == missing[: n - order]
    known = is_timed[order:] & is_timed[: n - order] & together
    scales = np.zeros(deflection.shape[1])
    for j in range(deflection.shape[1]):
        design = np.concatenate(
            [np.stack([lag[:, j] for lag in lagged], axis=1), driven[:, :, 0], np.ones((n - order, 1))],
            axis=1,
        )
        target = deflection[order:, j]
        whole = np.isfinite(design).all(axis=1) & np.isfinite(target) & together
        chosen = whole & known
        if np.count_nonzero(chosen) < 3 * design.shape[1]:
            return broken, silent
        for _ in range(4):
            size = np.linalg.norm(design[chosen], axis=0) + 1e-12
            weights = np.linalg.lstsq(design[chosen] / size, target[chosen], rcond=1e-7)[0] / size
            innovation = target - design @ weights
            scale = max(_spread(innovation[whole]), 1e-9)
            chosen = whole & known & (np.abs(innovation) < 4.0 * scale)
        scales[j] = scale
        size = np.where(whole, np.abs(innovation), np.nan)
        broken[order:] |= size > np.maximum(_BROKEN * scale, _SUDDEN * _usual_of_late(size))
    step = np.nan_to_num(np.abs(np.diff(deflection, axis=0)) / scales).max(axis=1)
    around = np.array([step[max(0, k - 6) : k + 6].max(initial=0.0) for k in range(n)])
    is_silent = around < 1.5 * _BROKEN
    # Across a gap nothing is foretold, and another loss would not break it.
    is_silent[order:] |= ~together
    return broken, np.asarray(is_silent)
