"""Clocks that single outputs have of their own, and jumps of clocks, estimated beside the modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from beam_ident.arrays import FloatArray
from beam_ident.data.own_clocks import OwnClock, middle_of
from beam_ident.data.prior import Prior
from beam_ident.data.records import InputSignal, LowPass, TimeRecord
from beam_ident.data.stamp_jumps import ClockJump, is_after
from beam_ident.modal.fit import ModalFit
from beam_ident.modal.identification_result import FrequencyChange
from beam_ident.modal.mode_change import ModeChange
from beam_ident.modal.model import ModalModel
from beam_ident.modal.regression import ModalRegression
from beam_ident.modal_identification.clock_search import own_clock_columns
from beam_ident.modal_identification.mode_changes import change_columns
from beam_ident.modal_identification.sensor_low_passes import low_pass_columns

_MIN_SD = 1e-9, 1e-12  # of a latency [s], of a rate: what is known is known so well
_OF_A_SAMPLE = 0.02  # half a sample is met so closely
_IDLE_CLOCK = 3.3  # standard deviations: an own clock that differs less from the common one is none


@dataclass(frozen=True, eq=False)
class SignalClocks:
    """What is known and estimated of the clocks of single signals, beside the clock that all outputs share.

    Attributes
    ----------
    output_names, input_names : tuple of str -- of the regressions that estimate them
    own : mapping -- clocks of outputs by name, as far as their stamps are corrected for them already
    jumps : tuple of ClockJump
    known : tuple of two mappings -- what is known of latencies and of rates of single outputs, by name
    low_passes : mapping -- of outputs by name, as far as their records state them already
    changes : tuple of ModeChange -- of modes, as far as the structure states them already
    """

    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    own: Mapping[str, OwnClock]
    jumps: tuple[ClockJump, ...]
    known: tuple[Mapping[str, Prior], Mapping[str, Prior]]
    low_passes: Mapping[str, LowPass] = field(default_factory=dict)
    changes: tuple[ModeChange, ...] = ()

    @staticmethod
    def of(
        regression: ModalRegression,
        own: Mapping[str, OwnClock] = MappingProxyType({}),
        jumps: Sequence[ClockJump] = (),
        known: tuple[Mapping[str, Prior], Mapping[str, Prior]] = ({}, {}),
        low_passes: Mapping[str, LowPass] = MappingProxyType({}),
    ) -> SignalClocks:
        """Return those of the signals of a regression."""
        names = regression.output_names, regression.input_names
        return SignalClocks(*names, own, tuple(jumps), known, low_passes, regression.structure.changes)

    def __bool__(self) -> bool:
        """Return whether there is anything to be estimated."""
        return bool(self.own or self.jumps or self.low_passes or self.changes)

    def estimated_in(
        self, regression: ModalRegression, fit: ModalFit, records: Sequence[TimeRecord]
    ) -> ModalRegression:
        """Return a regression that knows own clocks of some outputs, and jumps of clocks, to be estimates."""
        slopes, columns = own_clock_columns(regression, fit), {}
        by_change = change_columns(regression, fit, self.changes)
        for j, (name, (by_delay, by_rate)) in enumerate(zip(regression.output_names, slopes, strict=True)):
            own = [by_delay, by_rate][: self._n_of_clock(name)]
            if self._n_of_low_pass(name):
                own += list(low_pass_columns(regression, records, fit, name).T)
            own += list(by_change[j].T)
            own += [by_delay * after for after in self._after_jumps(j, regression, records)]
            if own:
                columns[j] = np.stack(own, axis=1)
        return regression.with_own_columns(columns)

    def _n_of_clock(self, name: str) -> int:
        """Return how many parameters the own clock of an output has: none, a delay, or a delay and a rate."""
        return 1 + int(self.own[name].runs) if name in self.own else 0

    def _n_of_low_pass(self, name: str) -> int:
        """Return how many parameters the low-pass of an output has: none, a lag, or a lag and a bend."""
        return 1 + int(self.low_passes[name].bend_s2 > 0.0) if name in self.low_passes else 0

    def _after_jumps(
        self, output: int, regression: ModalRegression, records: Sequence[TimeRecord]
    ) -> list[FloatArray]:
        """Return where the stamps of an output are late for each jump that it sees; -1 where they are early."""
        name, times = regression.output_names[output], regression.times[output]
        found = []
        for jump in self._jumps_of(name):
            # Jumps stand at stamps of the output's own clock.
            own = self.own.get(name, OwnClock())
            stamps = own.stamped(times, middle_of(records[jump.record]))
            after = is_after(jump, self.jumps, stamps)
            record = np.zeros_like(after)
            for number, part in regression.segments[output]:
                record[part] = float(number == jump.record)
            found.append(after * record * (1.0 if name in jump.signals else -1.0))
        return found

    def _jumps_of(self, name: str) -> list[ClockJump]:
        """Return the jumps that an output sees: of its own stamps, and of the input's."""
        seen = {name, *self.input_names}
        return [jump for jump in self.jumps if seen.intersection(jump.signals)]

    def _own_places(self, output: int, fit: ModalFit) -> list[int]:
        """Return where among all parameters those of an output alone are.

        Delay, rate and low-pass, then what it says of changes of modes, then of jumps.
        """
        name = self.output_names[output]
        count = self._n_of_clock(name) + self._n_of_low_pass(name)
        count += len(self.changes) + len(self._jumps_of(name))
        end = fit.n_theta + sum(len(found) for found in fit.coefficients[: output + 1])
        return list(range(end - count, end))

    def beyond(self, output: int, fit: ModalFit) -> tuple[FloatArray, FloatArray]:
        """Return what an output's own delay [s] and rate are beyond what its stamps were corrected by, and sd."""
        return self._further(output, fit, 0, self._n_of_clock(self.output_names[output]))

    def beyond_low_pass(self, output: int, fit: ModalFit) -> tuple[FloatArray, FloatArray]:
        """Return what lag [s] and bend [s^2] of an output are beyond what its records state, and sd."""
        name = self.output_names[output]
        return self._further(output, fit, self._n_of_clock(name), self._n_of_low_pass(name))

    def _further(self, output: int, fit: ModalFit, first: int, n: int) -> tuple[FloatArray, FloatArray]:
        """Return two parameters of an output alone, of which ``n`` are there, and their standard deviations."""
        places = self._own_places(output, fit)
        values, sds = np.zeros(2), np.zeros(2)
        values[:n] = fit.coefficients[output][len(fit.coefficients[output]) - len(places) :][
            first : first + n
        ]
        sds[:n] = np.sqrt(np.maximum(np.diag(fit.covariance)[places[first : first + n]], 0.0))
        return values, sds

    def idle(self, fit: ModalFit) -> list[str]:
        """Return the outputs whose own clock does not differ from that of the others after all."""
        found = []
        stated = {*self.known[0], *self.known[1]}
        for name, own in self.own.items():
            if name in stated:
                continue
            values, sds = self.beyond(self.output_names.index(name), fit)
            values += np.array([own.delay, own.rate])
            if np.all(np.abs(values) <= _IDLE_CLOCK * sds):
                found.append(name)
        return found

    def priors(
        self, fit: ModalFit, latency: Prior, clock_rate: Prior
    ) -> list[tuple[tuple[int, ...], float, float]]:
        """Return what is known of the latencies and rates of single outputs: common and own part together."""
        found = []
        commons = (latency, clock_rate)
        place = 2 * len(fit.omegas)
        for kind, (known, common, least) in enumerate(zip(self.known, commons, _MIN_SD, strict=True)):
            shared = (place,) if common.is_free else ()
            place += len(shared)
            for name, prior in known.items():
                own, clock = self._own_places(self.output_names.index(name), fit), self.own[name]
                corrected = (clock.delay, clock.rate)[kind] + (0.0 if common.is_free else common.mean)
                found.append(((*shared, own[kind]), prior.mean - corrected, max(prior.sd, least)))
        return found

    def estimated_jumps(self, fit: ModalFit) -> tuple[ClockJump, ...]:
        """Return the jumps as what the outputs that see them say together."""
        found = []
        for jump in self.jumps:
            places, values = [], []
            for j, name in enumerate(self.output_names):
                seen = self._jumps_of(name)
                if jump not in seen:
                    continue
                own = self._own_places(j, fit)[-len(seen) :]
                places.append(own[seen.index(jump)])
                values.append(float(fit.coefficients[j][seen.index(jump) - len(seen)]))
            further, sd = _together(places, values, fit)
            found.append(replace(jump, size_s=jump.size_s + further, size_sd=sd))
        return tuple(found)

    def estimated_changes(self, fit: ModalFit) -> list[tuple[ModeChange, float, float]]:
        """Return how modes change as all outputs say together, what is new in that, and its standard deviation."""
        found = []
        for k, change in enumerate(self.changes):
            places, values = [], []
            for j, name in enumerate(self.output_names):
                first = self._n_of_clock(name) + self._n_of_low_pass(name) + k
                places.append(own := self._own_places(j, fit)[first])
                values.append(_value_at(fit, j, own))
            further, sd = _together(places, values, fit)
            omega, share = float(fit.omegas[change.mode_of(fit.omegas)]), change.share + further
            found.append((replace(change, omega=omega, share=share), further, sd))
        return found

    def frequency_changes(self, fit: ModalFit) -> tuple[FrequencyChange, ...]:
        """Return how natural frequencies changed, in the order of the modes."""
        found = []
        for change, _, sd in self.estimated_changes(fit):
            first, last = change.ends_hz
            mode = change.mode_of(fit.omegas)
            found.append(FrequencyChange(mode, change.over, first, last, change.share, sd, change.swing))
        return tuple(sorted(found, key=lambda own: own.mode))

    def clocked(self, model: ModalModel, fit: ModalFit) -> ModalModel:
        """Return the model with the clocks and low-passes that outputs have of their own."""
        n_outputs = len(fit.coefficients)
        values, sds = np.zeros((n_outputs, 2)), np.zeros((n_outputs, 2))
        low_passes, low_pass_sd = np.zeros((n_outputs, 2)), np.zeros((n_outputs, 2))
        for j, name in enumerate(model.output_names):
            if (low_pass := self.low_passes.get(name)) is not None:
                further, low_pass_sd[j] = self.beyond_low_pass(j, fit)
                better = low_pass.moved(*further)
                low_passes[j] = better.lag_s, better.bend_s2
            if (own := self.own.get(name)) is not None:
                further, sds[j] = self.beyond(j, fit)
                values[j] = np.array([own.delay, own.rate]) + further
        return replace(
            model,
            output_delays=values[:, 0],
            output_delay_sd=sds[:, 0],
            output_rates=values[:, 1],
            output_rate_sd=sds[:, 1],
            output_low_passes=low_passes,
            output_low_pass_sd=low_pass_sd,
        )


def _value_at(fit: ModalFit, output: int, place: int) -> float:
    """Return a parameter of one output that stands somewhere among all."""
    first = fit.n_theta + sum(len(found) for found in fit.coefficients[:output])
    return float(fit.coefficients[output][place - first])


def _together(places: Sequence[int], values: Sequence[float], fit: ModalFit) -> tuple[float, float]:
    """Return what parameters that should be one are together, weighed by their covariance, and its sd."""
    covariance = fit.covariance[np.ix_(places, places)]
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    weights = np.linalg.pinv(covariance / np.outer(scale, scale), rcond=1e-9, hermitian=True)
    weights = weights / np.outer(scale, scale)
    total = max(float(np.sum(weights)), 1e-300)
    return float(np.sum(weights @ np.array(values))) / total, total**-0.5


def clock_sentences(model: ModalModel) -> list[str]:
    """Return what must be known of outputs with clocks of their own."""
    is_all = len(model.own_clocks) == len(model.output_names)
    others = (
        f"the clock of {' and '.join(model.input_names)} says" if is_all else "those of the other outputs"
    )
    found = []
    for name, own in model.own_clocks.items():
        who = f"The clock of {name} runs {1e6 * own.rate:+.4g} ppm fast, and its" if own.runs else "The"
        whose, what = ("", "delay and rate were") if own.runs else (f" of {name}", "delay was")
        late = f"{1e3 * abs(own.delay):.4g} ms {'later' if own.delay >= 0.0 else 'earlier'}"
        found.append(f"{who} stamps{whose} are {late} than {others}: its own {what} estimated along.")
    for j, (name, low_pass) in enumerate(zip(model.output_names, model.output_low_passes, strict=True)):
        if low_pass[0] > 0.0:
            behind, sd = LowPass(*low_pass), model.output_low_pass_sd[j, 0]
            found.append(
                f"{name} shows the motion through a low-pass, {1e3 * behind.lag_s:.4g} +- {1e3 * sd:.2g} ms late by "
                f"itself and at 71 % near {behind.cutoff_hz:.3g} Hz, as of a sensor's filter, or of an exposure "
                "that is not stated: it was estimated along. State low_pass, or exposure_s, where it is known."
            )
    return found


def hold_warnings(model: ModalModel, drives: Sequence[InputSignal], is_clock_known: bool) -> list[str]:
    """Return which inputs the outputs seem to follow half a sample early, or late, as if held otherwise than stated.

    Parameters
    ----------
    model : ModalModel
    drives : sequence of InputSignal -- of the records
    is_clock_known : bool -- otherwise only what comes before its cause tells a hold from a latency
    """
    late, sd = model.latency + model.output_delays, np.hypot(model.latency_sd, model.output_delay_sd)
    found = {}
    for drive in drives:
        is_held = drive.hold == "zoh"
        if drive.period_s is None or not (is_held or is_clock_known):
            continue
        half = (-0.5 if is_held else 0.5) * drive.period_s
        if np.all(np.abs(late - half) < _OF_A_SAMPLE * drive.period_s + _IDLE_CLOCK * sd) and np.all(
            sd < _OF_A_SAMPLE * drive.period_s
        ):
            found[drive.name] = (
                f"The outputs are half a sample of {drive.name} {'early' if is_held else 'late'}, as where it "
                f"{'changes' if is_held else 'stays'} between its samples, other than hold {drive.hold!r} says. "
                f"Set its hold to {'linear or cubic' if is_held else 'zoh'}."
            )
    return list(found.values())
