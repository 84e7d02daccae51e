"""How a tracker is doing, in words and numbers, once a second.

Counts and times are gathered frame by frame and cost next to nothing; ``report`` turns what has come together since
the last report into a level, sentences that say what is wrong and what to do, and values.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ros.vision.measurement.lateness import LatenessWatch
from beam_ros.vision.measurement.measuring_chain import Measurement, MeasuringChain

LEVELS = ("OK", "WARN", "ERROR")

_LATENCY_FRAMES = 1000
_MAX_LOST_SHARE = 0.01
_MAX_LATENCY_S = 0.5
_RATE_TOLERANCE = 0.1
_STAMP_AHEAD_S = 0.005


@dataclass(frozen=True)
class Complaint:
    """Something that is not as it should be: its level (WARN or ERROR) and a sentence."""

    level: str
    sentence: str


@dataclass(frozen=True)
class Report:
    """State over one period.

    Attributes
    ----------
    level : str -- OK, WARN or ERROR
    sentence : str -- every complaint, the gravest first, or that all is well
    values : dict of str to object -- counts since the start; rate, latency, noise and deviations of late
    """

    level: str
    sentence: str
    values: dict[str, object]


class Diagnosis:
    """Gathers what happens to the frames of one camera.

    Parameters
    ----------
    names : sequence of str -- of the markers, lowest first
    chain : MeasuringChain -- whose state is looked at when a report is made
    lateness : LatenessWatch -- which looks, too, when a report is made
    """

    def __init__(self, names: Sequence[str], chain: MeasuringChain, lateness: LatenessWatch) -> None:
        self._lateness = lateness
        self._names = tuple(names)
        self._chain = chain
        self._latencies_ns: deque[int] = deque(maxlen=_LATENCY_FRAMES)
        self._lost: Counter[tuple[str, str]] = Counter()
        self._last: Measurement | None = None
        self._arrived = self._measured = self._unusable = self._unchanged = 0
        self._trouble = ""
        self._before: Counter[str] = Counter()

    def frame_arrived(self) -> None:
        """Count a frame, whatever becomes of it."""
        self._arrived += 1

    def frame_unusable(self, reason: str) -> None:
        """Count a frame that could not be read, and remember why."""
        self._unusable += 1
        self._trouble = reason

    def frame_measured(self, measurement: Measurement, latency_ns: int) -> None:
        """Count a measured frame.

        Parameters
        ----------
        measurement : Measurement
        latency_ns : int -- from the frame's stamp until its displacement was published [ns]
        """
        self._measured += 1
        self._latencies_ns.append(latency_ns)
        self._last = measurement
        self._unchanged += "repeated" in measurement.reasons
        for name, reason in zip(self._names, measurement.reasons, strict=True):
            if reason != "ok":
                self._lost[name, reason] += 1

    def report(
        self, elapsed_s: float, source: Sequence[Complaint] = (), silence: str = "no frames"
    ) -> Report:
        """Say how the last period went.

        Parameters
        ----------
        elapsed_s : float -- since the last report [s]
        source : sequence of Complaint -- what the source of the frames has to say
        silence : str -- how to say that no frame came
        """
        continuity = self._chain.continuity
        now = Counter(
            arrived=self._arrived,
            measured=self._measured,
            unusable=self._unusable,
            unchanged=self._unchanged,
            missing=continuity.missing,
            repeated=continuity.repeated,
            backwards=continuity.backwards,
        )
        since = Counter({key: now[key] - self._before[key] for key in now})
        self._before = now
        complaints = [*source, *self._complaints(since, silence, is_source_silent=bool(source))]
        complaints.sort(key=lambda complaint: -LEVELS.index(complaint.level))
        values = self._values(now, since["measured"] / elapsed_s if elapsed_s > 0 else 0.0)
        if complaints:
            return Report(complaints[0].level, "; ".join(c.sentence for c in complaints), values)
        return Report("OK", f"{len(self._names)} markers in sight", values)

    def _complaints(self, since: Counter[str], silence: str, *, is_source_silent: bool) -> list[Complaint]:
        chain, found = self._chain, []
        if since["unusable"]:
            found.append(Complaint("ERROR", self._trouble))
        if chain.calibration_fault:
            found.append(Complaint("ERROR", chain.calibration_fault))
        found += [Complaint("WARN", doubt) for doubt in chain.doubts]
        if chain.lens_fault:
            found.append(Complaint("WARN", chain.lens_fault))
        if not since["arrived"]:
            return found if is_source_silent else [*found, Complaint("WARN", silence)]
        if since["repeated"] and not since["measured"]:
            found.append(
                Complaint(
                    "ERROR",
                    "all frames carry the same time stamp: expected a stamp of its own in each; check the camera "
                    "driver",
                )
            )
        elif since["repeated"] or since["backwards"]:
            found.append(
                Complaint(
                    "WARN",
                    f"{since['repeated'] + since['backwards']} frames came twice or late and were left out: expected "
                    "one camera whose stamps rise",
                )
            )
        continuity = chain.continuity
        if abs(continuity.rate_hz / continuity.nominal_hz - 1) > _RATE_TOLERANCE:
            found.append(
                Complaint(
                    "WARN",
                    f"frames come at {continuity.rate_hz:.4g} a second by their stamps: expected camera.rate, "
                    f"{continuity.nominal_hz:g}; set that to what the camera gives, or the camera to that",
                )
            )
        if since["missing"] > _MAX_LOST_SHARE * (since["missing"] + since["measured"]):
            found.append(
                Complaint(
                    "WARN",
                    f"{since['missing']} of {since['missing'] + since['measured']} frames are missing by their "
                    "stamps: expected none; give the computer less to do, or lower the camera's rate or size",
                )
            )
        return found + self._complaints_of_frames(since)

    def _complaints_of_frames(self, since: Counter[str]) -> list[Complaint]:
        found = []
        if self._last is not None and since["measured"]:
            lost = [
                f"{name} ({reason})"
                for name, reason in zip(self._names, self._last.reasons, strict=True)
                if reason not in ("ok", "unreadable", "repeated")
            ]
            if lost:
                found.append(
                    Complaint(
                        "WARN",
                        f"not in sight: {', '.join(lost)}; see tracker/debug_image for what the camera sees",
                    )
                )
            if since["unchanged"]:
                found.append(
                    Complaint(
                        "WARN",
                        f"{since['unchanged']} of {since['measured']} frames are the one before, bit for bit, though "
                        "the markers move, and show nothing new: expected a new image in each; set the camera, and "
                        "camera.rate, to a rate that it keeps in this light",
                    )
                )
            latency_s = float(np.median(list(self._latencies_ns)[-since["measured"] :])) * 1e-9
            if not -_STAMP_AHEAD_S <= latency_s <= _MAX_LATENCY_S:
                found.append(
                    Complaint(
                        "WARN",
                        f"frames are {latency_s:.3g} s old when they are measured: expected 0 to "
                        f"{_MAX_LATENCY_S:g} s; check the camera's clock, camera.stamp and camera.latency",
                    )
                )
        return found

    def _values(self, now: Counter[str], rate_hz: float) -> dict[str, object]:
        values: dict[str, object] = {
            "frames": now["arrived"],
            "rate_hz": round(rate_hz, 1),
            "unusable frames": now["unusable"],
            "dropped frames": now["missing"],
            "repeated frames": now["repeated"],
            "frames from the past": now["backwards"],
            "clock steps": self._chain.clock_steps,
        }
        if self._latencies_ns:
            median, p99 = np.percentile(self._latencies_ns, (50, 99)) * 1e-6
            values["latency_median_ms"] = round(float(median), 3)
            values["latency_p99_ms"] = round(float(p99), 3)
        self._lateness.look()
        if math.isfinite(self._lateness.late_s):
            values["stamps_late_s"] = round(self._lateness.late_s, 6)
            values["stamps_late_sd_s"] = round(self._lateness.late_sd_s, 6)
        tracker = self._chain.tracker
        for k, name in enumerate(self._names):
            values[f"{name} lost"] = sum(count for (who, _), count in self._lost.items() if who == name)
            values[f"{name} noise_grey"] = round(tracker.noise_grey[k], 2)
            if self._chain.prediction is not None:
                values[f"{name} foretold"] = int(self._chain.foretold_frames[k])
            if self._last is not None:
                values[f"{name} sigma_px"] = round(float(self._last.sigma_px[k]), 5)
        values.update({f"{name} {reason}": count for (name, reason), count in sorted(self._lost.items())})
        return values
