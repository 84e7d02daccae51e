"""Records of the default rig with one thing wrong each, as cameras, clocks, encoders and cables make it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from beam_ident import OutputSignal, TimeRecord
from benchmarks.ident.rig import Rig

Ailment = Callable[[Rig, int], TimeRecord | Sequence[TimeRecord]]

_NOISE = 5e-6  # of the camera [m]


def _with_output(record: TimeRecord, name: str, output: OutputSignal) -> TimeRecord:
    outputs = tuple(output if own.name == name else own for own in record.outputs)
    return replace(record, outputs=outputs)


def _later(record: TimeRecord, name: str, late_s: float, rate: float = 0.0) -> TimeRecord:
    own = record.output(name)
    return _with_output(record, name, replace(own, times_s=own.times_s * (1.0 + rate) + late_s))


def _through_low_pass(rig: Rig, seed: int) -> TimeRecord:
    """A sensor that averages over 40 ms, of which 5 ms are stated."""
    record = rig.record(seed)
    long = rig.full.simulate(rig.excitation.input_signal("acceleration"), rig.stamps[5:-5], 0.04)
    own = record.output("z285")
    noise = _NOISE * np.random.default_rng(1000 + seed).standard_normal(len(long))
    return _with_output(record, "z285", replace(own, times_s=rig.stamps[5:-5], values=long[:, 2] + noise))


def _clock_jumped(rig: Rig, seed: int) -> TimeRecord:
    record = rig.record(seed)
    times = np.array(record.outputs[0].times_s)
    times[times > 0.6 * times[-1]] += 0.03
    return replace(record, outputs=tuple(replace(own, times_s=times) for own in record.outputs))


def _clipped(rig: Rig, seed: int) -> TimeRecord:
    own = (record := rig.record(seed)).output("z285")
    most = 0.8 * float(np.max(own.values))
    return _with_output(record, "z285", replace(own, values=np.minimum(own.values, most)))


def _with_outliers(rig: Rig, seed: int) -> TimeRecord:
    record, rng = rig.record(seed), np.random.default_rng(2000 + seed)
    outputs = []
    for own in record.outputs:
        values, far = np.array(own.values), rng.random(len(own.values)) < 0.02
        values[far] += 2e-3 * rng.standard_normal(np.count_nonzero(far))
        outputs.append(replace(own, values=values))
    return replace(record, outputs=tuple(outputs))


def _with_gaps(rig: Rig, seed: int) -> TimeRecord:
    record = rig.record(seed)
    drive = record.inputs[0]
    times, values = drive.times_s, np.array(drive.values)
    for share in (0.2, 0.45, 0.7):
        begin = share * times[-1]
        values[(times > begin) & (times < begin + 0.15)] = np.nan
    return replace(record, inputs=(replace(drive, values=values),))


def _undeclared_input_noise(rig: Rig, seed: int) -> TimeRecord:
    record = rig.record(seed, encoder_sd=1e-5)
    return replace(record, inputs=(replace(record.inputs[0], sigma=0.0),))


def _slow_noise(rig: Rig, seed: int) -> TimeRecord:
    record, rng = rig.record(seed), np.random.default_rng(3000 + seed)
    outputs = [
        replace(own, values=own.values + 3e-5 * np.cumsum(rng.standard_normal(len(own.values))) / 10.0)
        for own in record.outputs
    ]
    return replace(record, outputs=tuple(outputs))


def _two_records(rig: Rig, seed: int) -> list[TimeRecord]:
    """The second is five times as loud."""
    first, second = rig.record(seed), rig.record(seed + 1)
    rng = np.random.default_rng(4000 + seed)
    louder = [
        replace(own, values=own.values + 5.0 * _NOISE * rng.standard_normal(len(own.values)))
        for own in second.outputs
    ]
    return [first, replace(second, outputs=tuple(louder))]


AILMENTS: dict[str, Ailment] = {
    "sound": lambda rig, seed: rig.record(seed),
    "late-output": lambda rig, seed: _later(rig.record(seed), "z225", 4e-3),
    "far-clock": lambda rig, seed: replace(
        (one := rig.record(seed)),
        outputs=tuple(replace(own, times_s=own.times_s + 1.3) for own in one.outputs),
    ),
    "own-rate": lambda rig, seed: _later(rig.record(seed), "z225", 0.0, 3e-4),
    "low-pass": _through_low_pass,
    "clock-jumped": _clock_jumped,
    "clipped": _clipped,
    "outliers": _with_outliers,
    "gaps": _with_gaps,
    "input-noise": _undeclared_input_noise,
    "slow-noise": _slow_noise,
    "shared-noise": lambda rig, seed: rig.record(seed, shared=(0.8, 0.8, 0.8)),
    "two-records": _two_records,
}
