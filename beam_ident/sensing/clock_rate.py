"""Whether an output's clock runs at another rate than its input's, by their samples alone.

A clock that is wrong by a per cent turns the end of a record through whole cycles against its beginning.  A fit is
then of nothing, and no small change of its delay shows why.  The samples do: at the right rate all stretches of a
record have one response, whatever it is.

Of 1000 clean records (one to three modes, six kinds of input, 0.1 to 100 % of noise) one was named wrongly; of such
records whose clock runs 0.3 or 1 % wrong, two in five are found.  A sweep shows nothing: its parts share no lines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beam_ident.arrays import ComplexArray, FloatArray
from beam_ident.data.records import InputSignal, OutputSignal
from beam_ident.numerics.piecewise import Instants, regular_period

_LEVEL = 1e-3  # chance that noise alone makes another rate explain as much more
_MAX_RATE = 0.03
_LINES = 400  # the strongest
_PLACES = 2000  # rates to either side
_MUCH = 0.01  # of the output's power: what explains less is left to finer tests
_WHOLE = 0.5  # of the output's power: what the right rate explains
_STRETCHES = (3, 4, 5)  # few and long ones: modes that ring on leak less into their lines
_MIN_SAMPLES = 64


@dataclass(frozen=True, eq=False)
class Stretches:
    """Spectra of an input and an output, stretch by stretch or blow by blow.

    Attributes
    ----------
    drives, answers : complex ndarray, shape (n_stretches, n_lines)
    omegas : ndarray, shape (n_lines,) -- [rad/s]
    starts_s : ndarray, shape (n_stretches,) -- when the stretches, or the blows that they begin with, were [s]
    """

    drives: ComplexArray
    answers: ComplexArray
    omegas: FloatArray
    starts_s: FloatArray

    @staticmethod
    def of(drive: FloatArray, output: FloatArray, period: float, count: int) -> Stretches:
        """Cut samples at common stamps, ``period`` apart [s], into stretches, each under a Hann window."""
        length = len(output) // count
        lines = slice(2, (length + 1) // 2)  # into the first line the mean leaks
        window = np.hanning(length + 1)[:length]

        def spectra(values: FloatArray) -> ComplexArray:
            rows = values[: count * length].reshape(count, length)
            return np.asarray(np.fft.rfft((rows - np.mean(rows, axis=1)[:, None]) * window, axis=1)[:, lines])

        omegas = 2.0 * np.pi * np.arange(lines.start, lines.stop) / (length * period)
        starts = length * period * np.arange(count, dtype=np.float64)
        return Stretches(spectra(drive), spectra(output), np.asarray(omegas, dtype=np.float64), starts)

    def best_rate(self) -> tuple[float, float, float, float]:
        """Return at which rate one response explains most, what share, what without, and the gain over chance's.

        Notes
        -----
        At a rate the lines of all stretches have one response: it explains ``|sum_k u_k* y_k|^2 / sum_k |u_k|^2`` of
        a line. Twice the gain over the noise is a chi-squared variable for a rate looked at. What leaks is noise
        here, and loudest at resonances: ``(sum p)^2 / sum p^2`` lines tell how loud, with the output's power p.
        """
        n, span = len(self.drives), float(np.ptp(self.starts_s)) if len(self.starts_s) else 0.0
        if len(self.omegas) < 2 or not span > 0.0:
            return 0.0, 0.0, 0.0, 0.0
        both = np.conj(self.drives) * self.answers
        keep = np.sort(np.argsort(np.sum(np.abs(both), axis=0))[::-1][:_LINES])
        both, omegas = both[:, keep], self.omegas[keep]
        power = np.maximum(np.sum(np.abs(self.drives[:, keep]) ** 2, axis=0), 1e-300)
        places = self.starts_s - float(np.mean(self.starts_s))
        step = 1.0 / (float(omegas[-1]) * span)
        reach = min(math.ceil(_MAX_RATE / step), _PLACES)
        rates = step * np.arange(-reach, reach + 1)
        turns = (np.exp(1j * np.outer(places, omegas * rate)) for rate in rates)
        explained = np.array([np.sum(np.abs(np.sum(both * turn, axis=0)) ** 2 / power) for turn in turns])
        by_line = np.sum(np.abs(self.answers[:, keep]) ** 2, axis=0)
        explained /= max(float(np.sum(by_line)), 1e-300)
        best = int(np.argmax(explained))
        whole, now = float(explained[best]), float(explained[reach])
        if whole - now < _MUCH or whole < _WHOLE or best in (0, len(rates) - 1):
            return float(rates[best]), whole, now, 0.0
        n_lines = float(np.sum(by_line)) ** 2 / max(float(by_line @ by_line), 1e-300)
        noise = max(1.0 - whole, 1e-12) / (n_lines * (n - 1))
        chance = -math.log(_LEVEL / len(rates)) * noise
        return float(rates[best]), whole, now, (whole - now) / chance


def clock_warnings(name: str, looks: Sequence[Stretches]) -> list[str]:
    """Return whether another rate of an output's clock lets one response explain much more of all stretches.

    Parameters
    ----------
    name : str -- of the output
    looks : sequence of Stretches -- one record, cut in some ways
    """
    rate, whole, now, gain = max((own.best_rate() for own in looks), key=lambda found: found[-1])
    if gain < 1.0 + math.log(len(looks)) / -math.log(_LEVEL):
        return []
    return [
        f"output {name!r}: one response explains {whole:.0%} of it if its clock runs {rate:+.2%} fast against the "
        f"input's, and {now:.0%} as its stamps say. What is given is right for neither; identify() finds the rate, "
        "or correct the stamps"
    ]


def clock_of_samples(name: str, drive: FloatArray, output: FloatArray, period: float) -> list[str]:
    """Return ``clock_warnings`` of an input and an output at common stamps.

    Parameters
    ----------
    name : str -- of the output
    drive, output : ndarray, shape (n,)
    period : float -- of the stamps [s]
    """
    return clock_warnings(name, [Stretches.of(drive, output, period, count) for count in _STRETCHES])


def clocks_of_record(outputs: Sequence[OutputSignal], drive: InputSignal) -> list[str]:
    """Return ``clock_warnings`` of outputs at regular stamps; of others nothing is known.

    Parameters
    ----------
    outputs : sequence of OutputSignal -- of one record
    drive : InputSignal -- the only one
    """
    said: list[str] = []
    signal = drive.signal()
    for output in outputs:
        keep = output.is_within(*drive.span_s)
        times, values = output.times_s[keep], np.array(output.values[keep])
        known, period = np.isfinite(values), regular_period(times)
        if period is None or np.count_nonzero(known) < _MIN_SAMPLES:
            continue
        values[~known] = np.interp(times[~known], times[known], values[known])
        seen = Instants.on(signal, times, output.exposure_s).mean(signal)[0]
        said += clock_of_samples(output.name, seen, values, period)
    return said
