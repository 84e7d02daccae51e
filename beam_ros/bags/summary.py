"""A bag at a glance: topics, losses, clock epochs, and how well the device's clock was followed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beam_ros.bags.apparatus import MEASURED, Apparatus, apparatus_of
from beam_ros.bags.errors import MissingTopicsError
from beam_ros.bags.reading import Bag, TopicCount
from beam_ros.bags.signals import HubSamples
from beam_ros.hub.clock_mapping import fit_affine
from beam_ros.hub.contract import ClockSync
from beam_ros.process.remote_paths import AnyPath, RemotePath

HUB_TOPICS = ("hub/applied", "hub/measured")


@dataclass(frozen=True)
class SignalSummary:
    """A sampled signal: samples, span [s], rate [Hz], gaps, and what was lost, double or unreadable."""

    topic: str
    samples: int
    duration_s: float
    rate_hz: float
    gaps: int
    lost: int
    duplicates: int
    unreadable: int
    epochs: tuple[int, ...] = ()
    names: tuple[str, ...] = ()
    unseen: tuple[int, ...] = ()


@dataclass(frozen=True)
class ClockSummary:
    """The device's clock in one epoch, against a straight line through its comparisons with the host.

    Attributes
    ----------
    epoch : int
    points : int
    rate_ppm : float -- how fast it runs against the host [1e-6]; NaN with fewer than three points
    residual_ns : float -- standard deviation from the line of the better half of the exchanges [ns]; NaN with
        fewer than three points
    median_rtt_ns : float -- of the exchanges [ns]
    """

    epoch: int
    points: int
    rate_ppm: float
    residual_ns: float
    median_rtt_ns: float


@dataclass(frozen=True)
class BagInfo:
    """What ``beam info`` says of a bag.

    Attributes
    ----------
    path : Path or RemotePath
    storage : str -- "mcap" or "sqlite3"
    namespace : str -- of the rig's topics
    start_ns, duration_ns : int -- by receive times [ns]
    message_count : int
    topics : tuple of TopicCount
    signals : tuple of SignalSummary -- the hub's batches and the displacements, as far as they are there
    clocks : tuple of ClockSummary -- one for each epoch
    sequences : tuple of str -- "id: state" of each sequence, as last reported
    excitation : dict or None -- the recipe
    damage : tuple of str -- what is amiss with the file itself; ``beam recover`` says the same
    provenance : mapping of str to str -- how the recording came about, as far as it says so
    remark : str -- what was not looked at, and how it can be; empty where everything was
    apparatus : Apparatus -- whether a beam was measured or simulated, and whether its date is one
    """

    path: AnyPath
    storage: str
    namespace: str
    start_ns: int
    duration_ns: int
    message_count: int
    topics: tuple[TopicCount, ...]
    signals: tuple[SignalSummary, ...]
    clocks: tuple[ClockSummary, ...]
    sequences: tuple[str, ...]
    excitation: dict[str, Any] | None
    damage: tuple[str, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
    remark: str = ""
    apparatus: Apparatus = MEASURED

    def to_dict(self) -> dict[str, Any]:
        """Return plain types."""
        plain = dataclasses.asdict(self)
        plain["path"] = str(self.path)
        return plain


def summarise(bag: Bag) -> BagInfo:
    """Read through a bag and say what is in it.

    Of a whole bag elsewhere only the index and the latched texts are read: its signals may be gigabytes.

    Parameters
    ----------
    bag : Bag -- open

    Returns
    -------
    BagInfo

    Raises
    ------
    BagTruncatedError
        The file is damaged further on.
    """
    texts = ("hub/sequence_state", "excitation/info", "/diagnostics")
    signals = []
    if bag.is_whole and isinstance(bag.path, RemotePath):
        bag.read(*texts)
        syncs: tuple[ClockSync, ...] = ()
        remark = "only the index was read; --from 0 --to 60 looks at the signals of a minute"
    else:
        bag.read(*HUB_TOPICS, "beam/displacement", "hub/clock_sync", *texts)
        signals = [_hub_signal(bag, topic) for topic in HUB_TOPICS if bag.count(topic)]
        if bag.count("beam/displacement"):
            signals.append(_displacement_signal(bag))
        syncs = bag.clock_syncs()
        remark = "" if bag.is_checked else "only a part was read, and no checksums but those of that part"
    states = {str(state.get("id")): str(state.get("state")) for state in bag.sequence_states()}
    excitation = bag.excitation_info()
    return BagInfo(
        path=bag.path,
        storage=bag.storage,
        namespace=bag.namespace,
        start_ns=bag.start_ns,
        duration_ns=bag.duration_ns,
        message_count=bag.message_count,
        topics=bag.topics,
        signals=tuple(signals),
        clocks=summarise_clocks(syncs),
        sequences=tuple(f"{name}: {state}" for name, state in states.items()),
        excitation=excitation,
        damage=tuple(bag.damage()),
        provenance=bag.provenance(),
        remark=remark,
        apparatus=apparatus_of(bag, excitation or {}),
    )


def summarise_clocks(syncs: tuple[ClockSync, ...]) -> tuple[ClockSummary, ...]:
    """Fit a line to each epoch's comparisons of host and device.

    Parameters
    ----------
    syncs : tuple of ClockSync

    Returns
    -------
    tuple of ClockSummary -- by epoch
    """
    summaries = []
    for epoch in sorted({sync.epoch for sync in syncs}):
        own = [sync for sync in syncs if sync.epoch == epoch]
        rate_ppm = residual_ns = np.nan
        if len(own) > 2 and own[0].device_ns != own[-1].device_ns:
            line = fit_affine(own)
            rate_ppm = (1.0 / line.rate - 1.0) * 1e6
            best = sorted(own, key=lambda sync: sync.rtt_ns)[: max(3, len(own) // 2)]
            residual_ns = float(np.std([sync.host_ns - line.host_ns(sync.device_ns) for sync in best]))
        rtt_ns = float(np.median([sync.rtt_ns for sync in own]))
        summaries.append(ClockSummary(epoch, len(own), float(rate_ppm), residual_ns, rtt_ns))
    return tuple(summaries)


def _hub_signal(bag: Bag, topic: str) -> SignalSummary:
    try:
        samples: HubSamples = bag.hub_samples(topic)
    except MissingTopicsError:
        return _unreadable_signal(bag, topic)
    steps = np.diff(samples.stamps_ns)
    period_ns = samples.period_ns or (float(np.median(steps)) if len(steps) else 0.0)
    return SignalSummary(
        topic=samples.topic,
        samples=len(samples.stamps_ns),
        duration_s=int(samples.stamps_ns[-1] - samples.stamps_ns[0]) * 1e-9,
        rate_hz=1e9 / period_ns if period_ns else 0.0,
        gaps=len(samples.gaps),
        lost=samples.lost,
        duplicates=samples.duplicates,
        unreadable=samples.unreadable.count,
        epochs=tuple(int(epoch) for epoch in np.unique(samples.epochs)),
    )


def _displacement_signal(bag: Bag) -> SignalSummary:
    try:
        table = bag.displacements()
    except MissingTopicsError:
        return _unreadable_signal(bag, "beam/displacement")
    steps = np.diff(table.stamps_ns)
    period = float(np.median(steps)) if len(steps) else 0.0
    late = steps[2 * steps > 3 * period] if period else steps[:0]
    return SignalSummary(
        topic=bag.full_name("beam/displacement"),
        samples=len(table.stamps_ns),
        duration_s=float(table.stamps_ns[-1] - table.stamps_ns[0]) * 1e-9,
        rate_hz=1e9 / period if period else 0.0,
        gaps=len(late),
        lost=int(np.sum(np.maximum(1, np.round(late / period) - 1))) if period else 0,
        duplicates=table.duplicates,
        unreadable=table.unreadable.count,
        names=table.names,
        unseen=tuple(int(count) for count in np.count_nonzero(np.isnan(table.positions), axis=0)),
    )


def _unreadable_signal(bag: Bag, topic: str) -> SignalSummary:
    return SignalSummary(bag.full_name(topic), 0, 0.0, 0.0, 0, 0, 0, unreadable=bag.count(topic))
