"""A camera that only leaves a file is synchronised with the hub by the low marker.

Ten millimetres above the clamp the beam moves almost as the hub does. The marker's record is laid over the
hub's: first coarsely, by the lag of the largest normalised correlation, then by least squares,

    x_low(t) = gain * alpha((1 + drift) t + offset) + zero

in which slow, large motion decides, and there the marker follows the hub without lag. What the beam's own
deflection leaves in the residuals counts as noise that is correlated over half a second.

A codec that keeps what changes leaves small changes out: what it shows stays behind by about the same way however
fast it moves, so that slow motion comes later than fast. For such a film -lag sign(d alpha/dt) is fitted in addition;
without it the times would be late, and those of slow motion later than the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from beam_ros.arrays import FloatArray
from beam_ros.vision.errors import SynchronisationError

_MAX_ITERATIONS = 30
_CONVERGED_S = 1e-7
_MIN_FRAMES = 20
_MIN_CORRELATION = 0.8
_MIN_OVERLAP = 0.5
_CLEARLY = 2.0
_CORRELATION_TIME_S = 0.5
"""Residuals remember for so long, which enters the standard deviations."""
_MIN_MOTION = 1e-3
"""A marker that moves by less than this share of the hub's way stands still."""
_SLOW = 0.01
"""At this share of the hub's largest speed it has a direction, and does not rest."""


@dataclass(frozen=True)
class Synchronisation:
    """How the camera's time relates to the hub's.

    Attributes
    ----------
    offset_s, offset_sd_s : float -- hub time = (1 + drift) * camera time + offset [s]
    drift, drift_sd : float -- relative difference of the two clocks' rates; 0 where it was not fitted
    gain : float -- displacement of the marker per displacement of the hub: 1 for a right scale
    zero_m : float -- the marker's displacement where the hub is at zero [m]
    covariance_s : float -- of offset and drift [s]
    lag_m, lag_sd_m : float -- way by which the film shows the marker behind its motion [m]; 0 where it was not fitted
    correlation : float -- of the two records at the coarse lag
    residual_rms_m : float -- [m]
    n_frames : int -- frames used
    """

    offset_s: float
    offset_sd_s: float
    drift: float
    drift_sd: float
    gain: float
    zero_m: float
    covariance_s: float
    lag_m: float
    lag_sd_m: float
    correlation: float
    residual_rms_m: float
    n_frames: int

    def hub_times(self, camera_times_s: npt.ArrayLike) -> FloatArray:
        """Times of the hub's clock at times of the camera's [s]."""
        return np.asarray((1 + self.drift) * np.asarray(camera_times_s, dtype=np.float64) + self.offset_s)

    def hub_time_sds(self, camera_times_s: npt.ArrayLike) -> FloatArray:
        """Return the standard deviations of ``hub_times`` [s]."""
        t = np.asarray(camera_times_s, dtype=np.float64)
        variance = self.offset_sd_s**2 + 2 * t * self.covariance_s + (t * self.drift_sd) ** 2
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def begun_earlier(self, by_s: float) -> Synchronisation:
        """Return the synchronisation of camera times that begin by so much earlier, and count from there [s]."""
        return replace(
            self,
            offset_s=self.offset_s + (1 + self.drift) * by_s,
            offset_sd_s=float(self.hub_time_sds(by_s)),
            covariance_s=self.covariance_s + by_s * self.drift_sd**2,
        )


def directions(speeds: FloatArray, largest: float) -> FloatArray:
    """Direction of motion, between -1 and 1, and 0 at rest, of speeds and the hub's largest one."""
    return np.asarray(speeds / np.hypot(speeds, _SLOW * largest))


def synchronise(
    hub_times_s: npt.ArrayLike,
    hub_positions_m: npt.ArrayLike,
    camera_times_s: npt.ArrayLike,
    low_marker_m: npt.ArrayLike,
    *,
    fits_drift: bool = False,
    fits_lag: bool = False,
    expected_s: float = 0.0,
) -> Synchronisation:
    """Find the camera's time in the hub's.

    Parameters
    ----------
    hub_times_s, hub_positions_m : array_like, shape (n_hub,) -- rising times and positions
    camera_times_s, low_marker_m : array_like, shape (n_frames,) -- rising times of mid-exposure by the camera's
        clock, and displacement of the lowest marker; NaN where it was not seen
    fits_drift : bool -- also fit the ratio of the clocks' rates
    fits_lag : bool -- also fit by how much the film stays behind, as behind a codec that keeps what changes
    expected_s : float -- an offset within this, either way, is preferred where it explains the motion about as well
        as any other: less than twice the unexplained power (by chance e^-7 with twenty independent frames) [s]

    Returns
    -------
    Synchronisation

    Raises
    ------
    SynchronisationError -- too few frames, no motion, records that do not resemble each other, or of which one is
        clearly better explained as the other's mirror image (less than half of the unexplained power, as above)
    """
    hub_t, hub_x = np.asarray(hub_times_s, dtype=np.float64), np.asarray(hub_positions_m, dtype=np.float64)
    t, x = np.asarray(camera_times_s, dtype=np.float64), np.asarray(low_marker_m, dtype=np.float64)
    for name, times, values in (("hub", hub_t, hub_x), ("camera", t, x)):
        if times.ndim != 1 or times.shape != values.shape or np.any(np.diff(times) <= 0):
            raise SynchronisationError(
                f"{name} record has times of shape {times.shape} and values of shape {values.shape}; expected one "
                "value for each of strictly rising times"
            )
    seen = np.isfinite(x)
    if int(seen.sum()) < _MIN_FRAMES or hub_t.size < _MIN_FRAMES:
        raise SynchronisationError(
            f"the low marker was seen in {int(seen.sum())} frames and the hub has {hub_t.size} samples; expected at "
            f"least {_MIN_FRAMES} of each"
        )
    t, x = t[seen], x[seen]
    if np.ptp(hub_x) == 0 or np.ptp(x) <= _MIN_MOTION * np.ptp(hub_x):
        raise SynchronisationError("the hub or the marker never moved; expected a motion to synchronise by")
    offsets, correlations = _correlations(hub_t, hub_x, t, x)
    offset, correlation = _chosen_offset(offsets, correlations, expected_s)
    _, against = _chosen_offset(offsets, -correlations, expected_s)
    if against >= _MIN_CORRELATION and _CLEARLY * (1 - against**2) < 1 - max(correlation, 0.0) ** 2:
        raise SynchronisationError(
            f"the low marker moves against the hub (correlation {-against:.3f}; {correlation:.3f} at best with it); "
            "expected the right direction: set camera.is_mirrored, or take it back, or mirror the pictures"
        )
    if correlation < _MIN_CORRELATION:
        raise SynchronisationError(
            f"the low marker follows the hub with a correlation of {correlation:.2f} at best; expected at least "
            f"{_MIN_CORRELATION}: is it the lowest marker, the same experiment, the right direction and frame rate?"
        )
    return _refined(hub_t, hub_x, t, x, offset, correlation, fits_drift, fits_lag)


def _chosen_offset(offsets: FloatArray, correlations: FloatArray, expected_s: float) -> tuple[float, float]:
    """Lag of the largest correlation; of those that explain the motion about as well, one that is expected."""
    best = int(np.argmax(correlations))
    near = int(np.argmax(np.where(np.abs(offsets) <= expected_s, correlations, -1.0)))
    if correlations[near] > 0 and 1 - correlations[near] ** 2 < _CLEARLY * (1 - correlations[best] ** 2):
        best = near
    return float(offsets[best]), float(correlations[best])


def _correlations(
    hub_t: FloatArray, hub_x: FloatArray, t: FloatArray, x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Offsets in steps of the camera's period, and the normalised correlation at each; 0 where it says nothing."""
    period = float(np.median(np.diff(t)))
    hub = np.interp(np.arange(hub_t[0], hub_t[-1], period), hub_t, hub_x)
    marker = np.interp(np.arange(t[0], t[-1], period), t, x)
    hub, marker = hub - hub.mean(), marker - marker.mean()
    size = 1 << int(hub.size + marker.size - 1).bit_length()

    def correlate(a: FloatArray, b: FloatArray) -> FloatArray:
        """Sum of a[k + lag] b[k] for every lag from -(len b - 1) to len a - 1."""
        product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        return np.concatenate([product[size - (b.size - 1) :], product[: a.size]])

    ones_hub, ones_marker = np.ones_like(hub), np.ones_like(marker)
    count = np.maximum(correlate(ones_hub, ones_marker), 1.0)
    sum_h, sum_m = correlate(hub, ones_marker), correlate(ones_hub, marker)
    power_h, power_m = correlate(hub**2, ones_marker), correlate(ones_hub, marker**2)
    variance = (power_h - sum_h**2 / count) * (power_m - sum_m**2 / count)
    total = float(np.sum(hub**2) * np.sum(marker**2))
    with np.errstate(invalid="ignore", divide="ignore"):
        normalised = (correlate(hub, marker) - sum_h * sum_m / count) / np.sqrt(variance)
    # Little overlap, or an overlap in which next to nothing moved, correlates by chance.
    is_fair = (count >= _MIN_OVERLAP * min(hub.size, marker.size)) & (variance > 1e-3 * total)
    offsets = hub_t[0] - t[0] + (np.arange(normalised.size) - (marker.size - 1)) * period
    return offsets, np.where(is_fair & np.isfinite(normalised), normalised, 0.0)


def _refined(
    hub_t: FloatArray,
    hub_x: FloatArray,
    t: FloatArray,
    x: FloatArray,
    offset: float,
    correlation: float,
    fits_drift: bool,
    fits_lag: bool,
) -> Synchronisation:
    """Gauss-Newton for offset, gain, zero, drift and lag."""
    slopes = np.gradient(hub_x, hub_t)
    largest = float(np.max(np.abs(slopes)))
    # Drift and offset are nearly uncorrelated about the middle of the record.
    middle = float(np.mean(t))
    shift, drift = offset + middle, 0.0
    for _ in range(_MAX_ITERATIONS):
        at = (1 + drift) * (t - middle) + shift
        inside = (at >= hub_t[0]) & (at <= hub_t[-1])
        if int(inside.sum()) < _MIN_FRAMES:
            raise SynchronisationError(
                f"{int(inside.sum())} frames lie within the hub's record; expected at least {_MIN_FRAMES}"
            )
        position, velocity = _hermite(hub_t, hub_x, slopes, at[inside])
        linear = np.stack([position, np.ones_like(position), -directions(velocity, largest)], axis=1)
        linear = linear[:, : 3 if fits_lag else 2]
        fitted, *_ = np.linalg.lstsq(linear, x[inside], rcond=None)
        gain, zero = fitted[:2]
        columns = [gain * velocity, *linear.T]
        if fits_drift:
            columns.append(gain * velocity * (t[inside] - middle))
        design = np.stack(columns, axis=1)
        residual = x[inside] - linear @ fitted
        step, *_ = np.linalg.lstsq(design, residual, rcond=None)
        shift += float(step[0])
        drift += float(step[-1]) if fits_drift else 0.0
        if abs(step[0]) < _CONVERGED_S:
            break
    covariance = _robust_covariance(design, residual, t[inside], _CORRELATION_TIME_S)
    # A few stretches of that length say little about their own scatter: Student's t for as many, less two, takes the
    # normal distribution's place (Cameron and Miller 2015), folded into the standard deviation at 95 %.
    stretches = residual.size / (_remembered(t[inside], _CORRELATION_TIME_S) + 1)
    covariance *= (float(stdtrit(max(stretches - 2.0, 1.0), 0.975)) / 1.96) ** 2
    back = np.array([1.0, -middle]) if fits_drift else np.array([1.0])
    chosen = np.array([0, len(covariance) - 1]) if fits_drift else np.array([0])
    of_clock = covariance[np.ix_(chosen, chosen)]
    offset_variance = float(back @ of_clock @ back)
    return Synchronisation(
        offset_s=shift - (1 + drift) * middle,
        offset_sd_s=math.sqrt(max(offset_variance, 0.0)),
        drift=drift,
        drift_sd=math.sqrt(float(of_clock[1, 1])) if fits_drift else 0.0,
        gain=float(gain),
        zero_m=float(zero),
        covariance_s=float(of_clock[1] @ back) if fits_drift else 0.0,
        lag_m=float(fitted[2]) if fits_lag else 0.0,
        lag_sd_m=math.sqrt(float(covariance[3, 3])) if fits_lag else 0.0,
        correlation=correlation,
        residual_rms_m=float(np.sqrt(np.mean(residual**2))),
        n_frames=int(inside.sum()),
    )


def _hermite(
    times: FloatArray, values: FloatArray, slopes: FloatArray, at: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Cubic interpolation and its derivative."""
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, times.size - 2)
    width = times[k + 1] - times[k]
    s = (at - times[k]) / width
    rise = values[k + 1] - values[k]
    left, right = slopes[k] * width, slopes[k + 1] * width
    second, third = 3 * rise - 2 * left - right, left + right - 2 * rise
    value = values[k] + s * (left + s * (second + s * third))
    slope = (left + s * (2 * second + 3 * s * third)) / width
    return np.asarray(value), np.asarray(slope)


def _robust_covariance(
    design: FloatArray, residual: FloatArray, t: FloatArray, correlation_time_s: float
) -> FloatArray:
    """Covariance of least squares whose residuals are correlated over a while (Newey and West 1987)."""
    inverse = np.linalg.pinv(design.T @ design)
    scores = design * residual[:, None]
    meat = scores.T @ scores
    n_lags = _remembered(t, correlation_time_s)
    for lag in range(1, n_lags + 1):
        cross = scores[lag:].T @ scores[:-lag]
        meat += (1 - lag / (n_lags + 1)) * (cross + cross.T)
    return np.asarray(inverse @ meat @ inverse)


def _remembered(t: FloatArray, correlation_time_s: float) -> int:
    """Frames over which residuals remember."""
    return min(int(correlation_time_s / float(np.median(np.diff(t)))), t.size // 4)
