"""What goes wrong in laboratories: each fault as a function of a sound experiment's raw arrays.

``names`` are words one of which a warning must hold to name the fault's cause.  ``factors`` say by what a fault
multiplies the true quantities where the data cannot tell that anything is wrong: other units are one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from tests.beam_ident.bad_input.experiments import PERIOD_S, Raw


@dataclass(frozen=True)
class Fault:
    """One row: what it does, how it may be named, and what it may rightly change."""

    spoil: Callable[[Raw], Raw]
    names: str = ""
    factors: Mapping[str, float] = field(default_factory=dict)


Change = Callable[[np.ndarray], Any]


def _seen(change: Change, only: str | None = None) -> Callable[[Raw], Raw]:
    """Return a fault of the outputs' values, of all or of one."""
    return lambda raw: replace(
        raw,
        seen={name: change(np.array(y)) if only in (None, name) else y for name, y in raw.seen.items()},
    )


def _driven(change: Change) -> Callable[[Raw], Raw]:
    """Return a fault of the input's values."""
    return lambda raw: replace(raw, drive=change(np.array(raw.drive)))


def _stamped(change: Change) -> Callable[[Raw], Raw]:
    """Return a fault of the outputs' stamps."""
    return lambda raw: replace(raw, stamps={name: change(np.array(t)) for name, t in raw.stamps.items()})


def _both(change: Change) -> Callable[[Raw], Raw]:
    """Return a fault of all values."""
    return lambda raw: (
        _driven(change)(_seen(change)(raw)) if raw.reference is None else _with_reference(raw, change)
    )


def _with_reference(raw: Raw, change: Change) -> Raw:
    return replace(_driven(change)(_seen(change)(raw)), reference=change(np.array(raw.reference)))


def _clock(change: Change) -> Callable[[Raw], Raw]:
    """Return a fault of all stamps."""
    return lambda raw: replace(_stamped(change)(raw), drive_times=change(np.array(raw.drive_times)))


def _at(index: float, value: float) -> Change:
    """Return a change of the sample that stands at a share of the record."""

    def change(values: np.ndarray) -> np.ndarray:
        values[int(index * (len(values) - 1))] = value
        return values

    return change


def _late(values: np.ndarray) -> np.ndarray:
    """Return which samples lie in the last third."""
    return np.arange(len(values)) >= 2 * len(values) // 3


def _rounded(bits: int) -> Change:
    def change(values: np.ndarray) -> np.ndarray:
        step = np.ptp(values) / 2**bits
        return np.round(values / step) * step

    return change


def _random(values: np.ndarray, seed: int = 5) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(len(values))


def _masked(values: np.ndarray) -> Any:
    """Return values of which a tenth is masked, and holds what a logger leaves there."""
    mask = np.random.default_rng(6).random(len(values)) < 0.1
    mask[[0, -1]] = False
    return np.ma.MaskedArray(np.where(mask, -999.0, values), mask)


def _spiky(values: np.ndarray) -> np.ndarray:
    places = np.random.default_rng(7).choice(len(values), len(values) // 100, replace=False)
    values[places] += 10.0 * np.std(values)
    return values


def _sparse(values: np.ndarray) -> np.ndarray:
    return np.where(np.random.default_rng(8).random(len(values)) < 0.3, np.nan, values)


def _dropped(values: np.ndarray) -> np.ndarray:
    """Return values that are zero for ten samples, three times."""
    for share in (0.3, 0.55, 0.8):
        first = int(share * len(values))
        values[first : first + 10] = 0.0
    return values


def _wrapped(values: np.ndarray) -> np.ndarray:
    """Return what a counter leaves that overflows at 0.7 of the largest value."""
    limit = 0.7 * np.max(np.abs(values))
    return (values + limit) % (2.0 * limit) - limit


def _passed(values: np.ndarray) -> np.ndarray:
    """Return what an amplifier with a time constant of 10 ms leaves."""
    kept = np.exp(-PERIOD_S / 0.01)
    return lfilter([1.0 - kept], [1.0, -kept], values)


def _coupled(values: np.ndarray) -> np.ndarray:
    """Return what a charge amplifier with a high-pass at 0.5 Hz leaves."""
    kept = np.exp(-2.0 * np.pi * 0.5 * PERIOD_S)
    return lfilter(0.5 * (1.0 + kept) * np.array([1.0, -1.0]), [1.0, -kept], values)


def _hole(values: np.ndarray) -> np.ndarray:
    n = len(values)
    values[n // 4 : 3 * n // 4] = np.nan
    return values


def _crossed(raw: Raw) -> Raw:
    """Return channels whose plugs were swapped on the way; of one channel alone, with its input."""
    late = {name: _late(y) for name, y in raw.seen.items()}
    if len(raw.seen) == 1:
        n = min(len(raw.drive), len(raw.seen["y"]))
        place = np.flatnonzero(late["y"][:n])
        y, u = np.array(raw.seen["y"]), np.array(raw.drive)
        y[place], u[place] = raw.drive[place], raw.seen["y"][place]
        return replace(raw, drive=u, seen={"y": y})
    one, other = raw.seen.values()
    return replace(raw, seen={"y": np.where(late["y"], other, one), "z": np.where(late["z"], one, other)})


def _input_and_output_swapped(raw: Raw) -> Raw:
    n = min(len(raw.drive), *(len(y) for y in raw.seen.values()))
    times = next(iter(raw.stamps.values()))[:n]
    held = np.interp(times, raw.drive_times, raw.drive)
    return replace(
        raw,
        drive=np.array(raw.seen["y"])[:n],
        drive_times=times,
        seen={name: held + 1e-3 * np.std(held) * _random(held, 9) for name in raw.seen},
        stamps=dict.fromkeys(raw.stamps, times),
        reference=None if raw.reference is None else raw.reference[:n],
    )


def _grown(raw: Raw) -> Raw:
    return replace(
        raw,
        seen={
            name: sign * np.exp(3.0 * raw.stamps[name])
            for name, sign in zip(raw.seen, (1.0, -1.0), strict=False)
        },
    )


def _copied(raw: Raw) -> Raw:
    return replace(raw, seen=dict.fromkeys(raw.seen, raw.seen["y"]))


def _echoed(raw: Raw) -> Raw:
    """Return a record whose first output is wired to the input."""
    held = np.interp(raw.stamps["y"], raw.drive_times, raw.drive)
    return replace(raw, seen={**raw.seen, "y": held})


def _hum(values: np.ndarray) -> np.ndarray:
    """Return values with mains at 50 Hz on them, seen by a sampler that runs a little off 100 Hz."""
    return values + 0.3 * np.std(values) * np.sin(2.0 * np.pi * 0.237 * np.arange(len(values)))


def _dead_band(values: np.ndarray) -> np.ndarray:
    width = 0.3 * np.std(values)
    return np.sign(values) * np.maximum(np.abs(values) - width, 0.0)


def _short(raw: Raw, n: int) -> Raw:
    last = next(iter(raw.stamps.values()))[:n][-1]
    kept = max(int(np.searchsorted(raw.drive_times, last)) + 1, 2)
    return replace(
        raw,
        seen={name: y[:n] for name, y in raw.seen.items()},
        stamps={name: t[:n] for name, t in raw.stamps.items()},
        drive=raw.drive[:kept],
        drive_times=raw.drive_times[:kept],
        reference=None if raw.reference is None else raw.reference[:kept],
    )


def _strided(values: np.ndarray) -> np.ndarray:
    return np.repeat(values, 2)[::2]


def _frozen_array(values: np.ndarray) -> np.ndarray:
    values.setflags(write=False)
    return values


def _moving(raw: Raw) -> Raw:
    """Return a record that begins when the motion is under way: its first quarter is cut off."""
    first = raw.drive_times[len(raw.drive_times) // 4] if raw.reference is None else 0.0
    if not first:
        return raw
    drive = raw.drive_times >= first
    seen = {name: t > first for name, t in raw.stamps.items()}
    return replace(
        raw,
        drive=raw.drive[drive],
        drive_times=raw.drive_times[drive],
        seen={name: y[seen[name]] for name, y in raw.seen.items()},
        stamps={name: t[seen[name]] for name, t in raw.stamps.items()},
    )


def _times(factor: float) -> dict[str, float]:
    """Return that every gain is multiplied; by infinity, that it means nothing."""
    return dict.fromkeys(("gain of y", "size of y", "size of z", "turn of y", "turn of z"), factor)


def _noisy(size: float, declared: float = 0.0) -> Callable[[Raw], Raw]:
    """Return a fault by noise on the input, in units of its own deviation, and what is declared of it."""
    return lambda raw: replace(
        raw,
        drive=raw.drive + size * np.std(raw.drive) * _random(raw.drive),
        sigma=declared * np.std(raw.drive),
    )


def _bent(values: np.ndarray) -> np.ndarray:
    return values * (1.0 + 0.3 * np.square(values / (np.std(values) or 1.0)))


def _offset(size: float) -> Change:
    return lambda y: y + size * np.std(y)


NUMBERS = "nan|inf|complex|number|shape"
STAMPS = "stamp|jitter|clock|late|delay|hold"
MIDDLE = "changes? (in|its)|change of|middle|stuck|gain"
DAMAGE = "outlier|spike|stand"
UNRELATED = "chance|nothing to do|unrelated"
DRIFT = "drift|offset|ramp|rigid"
SAME = "same samples|copy|copies"

FAULTS: Mapping[str, Fault] = {
    # Not numbers.
    "an output with one NaN": Fault(_seen(_at(0.5, np.nan)), "missing|gap"),
    "outputs of NaN": Fault(_seen(lambda y: y * np.nan), NUMBERS),
    "an output with inf": Fault(_seen(_at(0.4, np.inf)), NUMBERS),
    "an input with NaN": Fault(_driven(_at(0.3, np.nan)), "gap|missing"),
    "an input that ends with NaN": Fault(_driven(_at(1.0, np.nan)), "gap|missing"),
    "an input with inf": Fault(_driven(_at(0.4, -np.inf)), NUMBERS),
    "nothing": Fault(_seen(lambda y: y[:0]), NUMBERS),
    "one sample": Fault(lambda raw: _short(raw, 1), "short|samples"),
    "three samples": Fault(lambda raw: _short(raw, 3), "short|samples"),
    "nine samples": Fault(lambda raw: _short(raw, 9), "short|samples"),
    "less than a period": Fault(lambda raw: _short(raw, 20), "short|samples"),
    "all but five missing": Fault(_seen(lambda y: np.where(np.arange(len(y)) < 5, y, np.nan)), "missing|gap|samples"),
    "complex outputs": Fault(_seen(lambda y: y + 0j), NUMBERS),
    "words for values": Fault(_seen(lambda y: [*y.astype(str)[:-1].tolist(), "overrun"]), NUMBERS),
    "a table for a row": Fault(_seen(lambda y: y[:, None]), NUMBERS),
    "one value too few": Fault(_seen(lambda y: y[:-1]), NUMBERS),
    # The same in other clothes: nothing may change.
    "lists": Fault(_seen(lambda y: y.tolist())),
    "objects": Fault(_both(lambda y: y.astype(object))),
    "float32": Fault(_both(lambda y: y.astype(np.float32))),
    "a strided array": Fault(_both(_strided)),
    "a read-only array": Fault(_both(_frozen_array)),
    "a masked array": Fault(_seen(_masked), "missing|masked"),
    "a masked input": Fault(_driven(_masked), "missing|masked|gap"),
    # Other units: a million times larger is no fault.
    "a million times larger": Fault(_both(lambda y: 1e6 * y)),
    "a million times smaller": Fault(_both(lambda y: 1e-6 * y)),
    "outputs in thousandths": Fault(
        _seen(lambda y: 1e3 * y), "milli|1000|unit", _times(1e3)
    ),
    "outputs of the other sign": Fault(
        _seen(lambda y: -y), "sign", _times(-1.0)
    ),
    "outputs of 1e-300": Fault(_seen(lambda y: 1e-300 * y), "unit"),
    "outputs of 1e300": Fault(_seen(lambda y: 1e300 * y), "unit"),
    "an input of 1e300": Fault(_driven(lambda u: 1e300 * u), "unit"),
    "counts of 16 bits": Fault(
        _seen(lambda y: (y * 2000.0 / np.max(np.abs(y))).astype(np.int16)), "milli|1000|unit|gain",
        _times(np.inf),
    ),
    # Nothing in it.
    "a constant input": Fault(_driven(lambda u: np.full(len(u), 2.0)), "constant|nothing"),
    "an input at rest": Fault(_driven(lambda u: 0.0 * u), "rest|still|nothing|zero"),
    "constant outputs": Fault(_seen(lambda y: np.full(len(y), 3.0)), "constant"),
    "outputs that move by rounding": Fault(_seen(lambda y: 3.0 + 4e-16 * np.sign(y)), "constant|rounding"),
    "an input that moves when all is over": Fault(
        _driven(lambda u: np.concatenate([np.zeros(len(u) - 1), [1.0]])), "rest|still|nothing|zero"
    ),
    "outputs that grow for ever": Fault(
        _grown, "grow|unstable|outgrow|" + UNRELATED + "|" + DRIFT
    ),
    "outputs of zero": Fault(_seen(lambda y: 0.0 * y), "constant"),
    "an unrelated input": Fault(_driven(lambda u: np.std(u) * _random(u)), UNRELATED),
    "outputs of noise": Fault(_seen(lambda y: np.std(y) * _random(y)), UNRELATED),
    "input and output swapped": Fault(_input_and_output_swapped, "swap|precede|before the input|" + UNRELATED),
    "an output wired to the input": Fault(_echoed, SAME + "|" + UNRELATED + "|follow"),
    "one channel's copy of the other": Fault(_copied, SAME),
    # Stamps.
    "stamps reversed": Fault(_stamped(lambda t: t[::-1]), STAMPS),
    "stamps of another record": Fault(
        _stamped(lambda t: np.sort(np.random.default_rng(0).uniform(t[0], t[-1], len(t)))), STAMPS + "|" + UNRELATED
    ),
    "a hundredth of a second in common": Fault(
        lambda raw: _stamped(lambda t: t + raw.drive_times[-1] - t[0] - 0.01)(raw), STAMPS + "|overlap|samples"
    ),
    "stamps twice": Fault(_stamped(lambda t: np.repeat(t[::2], 2)[: len(t)]), STAMPS),
    "stamps of NaN": Fault(_stamped(_at(0.5, np.nan)), STAMPS),
    "stamps that jitter": Fault(
        _stamped(lambda t: t + 0.3 * PERIOD_S * np.random.default_rng(3).uniform(-1.0, 1.0, len(t))), STAMPS
    ),
    "stamps of the outputs in ms": Fault(_stamped(lambda t: 1e3 * t), STAMPS + "|overlap|samples"),
    "all stamps in ms": Fault(_clock(lambda t: 1e3 * t), factors={"frequency": 1e-3, **_times(np.inf)}),
    "stamps since 1990": Fault(_clock(lambda t: 1e9 + t), "periods still change"),  # start_s is as it was
    "stamps late by 50 ms": Fault(_stamped(lambda t: t + 0.05), STAMPS),
    "a clock wrong by 1 %": Fault(_stamped(lambda t: 1.01 * t), STAMPS),
    # Declarations.
    "an exposure ten times too long": Fault(
        lambda raw: replace(raw, exposure_s=10.0 * (raw.exposure_s or 0.005)), "exposure"
    ),
    "another hold": Fault(
        lambda raw: replace(raw, hold="linear" if raw.hold == "zoh" else "zoh"), "hold|late|delay"
    ),
    "a hold that there is not": Fault(lambda raw: replace(raw, hold="spline"), "hold"),
    "noise on the input, undeclared": Fault(_noisy(0.05), "noise on|input"),
    "noise on the input, declared ten times too large": Fault(_noisy(0.003, 0.03), "input"),
    "noise on the input, declared ten times too small": Fault(_noisy(0.03, 0.003), "input"),
    # Sensors.
    "a clipped sensor": Fault(
        _seen(lambda y: np.clip(y, np.quantile(y, 0.08), np.quantile(y, 0.92))), "clipped"
    ),
    "a sensor of 3 bits": Fault(_seen(_rounded(3)), "rounding|distortion"),
    "a channel that is stuck from some instant on": Fault(
        _seen(lambda y: np.where(_late(y), y[2 * len(y) // 3], y), "y"), "stuck|" + MIDDLE
    ),
    "a channel that is dead from some instant on": Fault(
        _seen(lambda y: np.where(_late(y), 0.0, y), "y"), "stuck|" + MIDDLE
    ),
    "a camera that shows every frame twice": Fault(
        _seen(lambda y: np.repeat(y[::2], 2)[: len(y)]), "twice|repeat|frozen"
    ),
    "a gain that falls by a fifth": Fault(
        _seen(lambda y: np.where(_late(y), 0.8 * y, y), "y"), MIDDLE
    ),
    "channels swapped on the way": Fault(_crossed, MIDDLE),
    "outputs that drop out": Fault(_seen(_dropped), "stuck|" + DAMAGE),
    "outputs that wrap round": Fault(_seen(_wrapped), "wraps|" + DAMAGE + "|nonlinear|distortion"),
    "a sensor behind a low-pass": Fault(_seen(_passed, "y"), "low-pass|late|exposure|delay"),
    "sensors behind a low-pass": Fault(_seen(_passed), "low-pass|late|exposure|delay"),
    "AC coupling": Fault(_seen(_coupled), "high-pass|" + DRIFT),
    "hum": Fault(_seen(_hum), "hum|line"),
    "drift": Fault(_seen(lambda y: y + np.std(y) * np.linspace(-1.0, 2.0, len(y)) ** 2), DRIFT),
    "an offset": Fault(_seen(_offset(1.0)), DRIFT),
    "an offset that jumps": Fault(
        _seen(lambda y: y + 0.3 * np.std(y) * _late(y)), DRIFT + "|jump"
    ),
    "a wild value": Fault(_seen(_at(0.5, 1e6)), DAMAGE),
    "one outlier": Fault(_seen(lambda y: _at(0.6, 20.0 * float(np.std(y)))(y)), DAMAGE),
    "spikes": Fault(_seen(_spiky), DAMAGE),
    "30 % missing": Fault(_seen(_sparse), "missing"),
    "a hole of half the record": Fault(_seen(_hole), "missing|gap"),
    # The record, the plant and its drive.
    "a record of a tenth": Fault(
        lambda raw: _short(raw, max(len(raw.stamps["y"]) // 10, 100)), "short|samples|longer"
    ),
    "a record that begins in motion": Fault(_moving, "motion"),
    "an input without power in the band": Fault(
        _driven(lambda u: np.std(u) * np.sin(2.0 * np.pi * 0.2 * PERIOD_S * np.arange(len(u)))), UNRELATED
    ),
    "a sensor with a dead band": Fault(_seen(_dead_band), "nonlinear|dead band|distortion"),
    "a saturating actuator": Fault(_driven(_bent), "nonlinear|saturat|distortion"),
}  # fmt: skip

HOPELESS = (
    "one sample", "three samples", "nine samples", "all but five missing", "a hundredth of a second in common",
    "constant outputs", "outputs that move by rounding", "an input at rest", "an input that moves when all is over",
)  # fmt: skip
"""Faults after which nothing is left to identify from: quick for every estimator."""

OF_THE_OUTPUT_ALONE = ("fit_free_decay", "fit_sine")
WITHOUT_A_MODEL = (
    "hammer_response", "periodic_response", "welch_response", "local_polynomial_response", "stepped_sine_response",
    "half_power_damping", "circle_fit",
)  # fmt: skip
BLIND: Mapping[str, tuple[str, ...]] = {
    # Nothing but another clock can tell how long a second is.
    "stamps of the outputs in ms": OF_THE_OUTPUT_ALONE,
    "all stamps in ms": OF_THE_OUTPUT_ALONE,
    "a clock wrong by 1 %": OF_THE_OUTPUT_ALONE,
    "stamps of another record": (*OF_THE_OUTPUT_ALONE, "stepped_sine_response"),
    # A response without a model is right for the signals as they are declared: a delay, a hold, an exposure and
    # the inverse of a plant are responses as well, and a bent one is best linear.
    "stamps late by 50 ms": WITHOUT_A_MODEL,
    "another hold": WITHOUT_A_MODEL,
    "a sensor behind a low-pass": WITHOUT_A_MODEL,
    "sensors behind a low-pass": WITHOUT_A_MODEL,
    "AC coupling": WITHOUT_A_MODEL,
    "an exposure ten times too long": WITHOUT_A_MODEL,
    "input and output swapped": (*WITHOUT_A_MODEL, "fit_sine"),
    "an output wired to the input": (*WITHOUT_A_MODEL, "fit_sine"),
    "a sensor with a dead band": WITHOUT_A_MODEL,
    "a saturating actuator": WITHOUT_A_MODEL,
    # A score says how well a model predicts these data, whatever became of them.
    "outputs that drop out": ("validate",),
    # Two sines, each seen once, may have two gains.
    "a gain that falls by a fifth": ("stepped_sine_response",),
    "channels swapped on the way": ("stepped_sine_response",),
}
"""What an estimator cannot know, whatever it does: these cases are no part of the table."""


def cases(estimators: Iterable[str]) -> list[tuple[str, str]]:
    """Return every pair of estimator and fault that the table has."""
    return [(name, fault) for fault in FAULTS for name in estimators if name not in BLIND.get(fault, ())]
