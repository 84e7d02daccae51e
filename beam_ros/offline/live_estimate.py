"""The estimate that grows with what is heard of a rig: the offline identification of the samples so far.

Messages become a bag in memory, and that an experiment as every bag does: the same clocks, gaps, restarts and notes.
What is estimated from it is said as the record of ``identification/live``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from beam_ident import (
    Aim,
    EstimationError,
    GrowingIdentification,
    ModalModel,
    TimeRecord,
    aims_of,
    local_polynomial_response,
)
from beam_ident.evaluation.assumptions import assumptions
from beam_ident.modal.identification_result import IdentificationResult
from beam_ident.modal_identification.growing import duration_of
from beam_ros.arrays import FloatArray
from beam_ros.bags.live.heard import HeardBag
from beam_ros.errors import faults_of_the_user
from beam_ros.interfaces.rig_parameters import LiveSettings
from beam_ros.messages import SECOND_NS
from beam_ros.messages.live_identification import (
    LiveAim,
    LiveCost,
    LiveIdentification,
    LiveMode,
    LiveOutput,
    LiveResponse,
    LiveShape,
    LiveTest,
    State,
)
from beam_ros.offline.loading.experiment import Experiment, experiment_of

_NEEDED = ("hub/measured", "beam/displacement")
_OVER = ("done", "aborted", "underrun")

START = LiveIdentification(
    state="waiting",
    sentence="Nothing was heard of the hub and the markers yet: start the nodes of the rig.",
    record_s=0.0,
    samples={},
    started=None,
    modes=(),
    response=None,
    shape=None,
    tests=(),
    aims=(),
    cost=LiveCost(0.0, 0.0),
)
"""What is said before anything is known."""


class LiveEstimate:
    """Hears messages, and says what they tell so far.

    Parameters
    ----------
    settings : LiveSettings
    processor_time : callable -- returns the time that this process has spent [s]

    Raises
    ------
    EstimationError
        The aims are no aims.
    """

    def __init__(
        self, settings: LiveSettings, processor_time: Callable[[], float] = time.process_time
    ) -> None:
        self._settings, self._processor_time = settings, processor_time
        self.aims = aims_asked(settings)
        self._bag = HeardBag(memory_s=settings.memory)
        self._growing: GrowingIdentification | None = None
        self._sequence: object = None
        self._is_over = self._is_known = False
        self._spent_s = 0.0  # on what is not an estimate: reading, measured responses
        self._measured: tuple[float, dict[str, tuple[FloatArray, FloatArray]]] = 0.0, {}
        self.said = replace(
            START, aims=tuple(LiveAim(a.name, a.relative_sd, None, None, False) for a in self.aims)
        )

    def hear(self, topic: str, data: bytes, receive_ns: int) -> None:
        """Take a message of one of ``LIVE_NEEDS``, as CDR bytes, and when it came [ns, UNIX]."""
        self._bag.hear(topic, data, receive_ns)

    def step(self) -> LiveIdentification:
        """Look at what was heard, and return what is known; most often that is what was known before."""
        if not all(self._bag.count(topic) for topic in _NEEDED):
            missing = [topic for topic in _NEEDED if not self._bag.count(topic)]
            self.said = replace(
                self.said,
                sentence=f"Nothing on {' and '.join(missing)} yet: start the nodes that publish there.",
            )
            return self.said
        begun = self._processor_time()
        self._follow_sequence()
        heard_s = self._bag.duration_ns * 1e-9
        if not self._is_over and (self._has_ended() or self._may_spend(heard_s)):
            try:
                self._estimate(begun)
            except faults_of_the_user() as err:
                state: State = "failed" if self.said.state == "waiting" else self.said.state
                self.said = replace(self.said, state=state, sentence=str(err))
        return self.said

    def close(self) -> None:
        """Let go of what was heard."""
        self._bag.close()

    def _follow_sequence(self) -> None:
        """Begin anew with every excitation."""
        info = self._bag.excitation_info() or {}
        if info.get("sequence_id") != self._sequence:
            self._sequence = info.get("sequence_id")
            self._growing, self._is_over, self._is_known = None, False, False
            self._measured = 0.0, {}

    def _has_ended(self) -> bool:
        """Return whether the excitation that is looked at is over."""
        states = [own for own in self._bag.sequence_states() if own.get("id") == self._sequence]
        return bool(self._sequence is not None and states and states[-1].get("state") in _OVER)

    def _may_spend(self, heard_s: float) -> bool:
        """Return whether what was heard pays for an estimate, beside what was spent on all else."""
        free_s = heard_s - self._spent_s / self._settings.share_of_core
        return free_s >= 0.0 if self._growing is None else self._growing.is_due(free_s)

    def _estimate(self, begun: float) -> None:
        experiment = experiment_of(self._bag)
        records, clock_rate, latency = experiment.records, experiment.clock_rate, experiment.latency
        growing = self._growing
        if growing is None:
            growing = self._growing = GrowingIdentification(
                experiment.structure,  # type: ignore[arg-type]
                share_of_core=self._settings.share_of_core,
                processor_time=self._processor_time,
            )
        before = growing.spent_s
        self._is_over = self._has_ended()
        if self._is_over:
            growing.searched(records, clock_rate, latency)
        else:
            growing.grown(records, clock_rate, latency)
            self._is_known |= bool(self.aims) and growing.knows(records, self.aims, clock_rate)
        if growing.searched_s != self._measured[0]:
            self._measured = growing.searched_s, _measured(records[0])
        fitted_s = growing.spent_s - before
        self._spent_s += self._processor_time() - begun - fitted_s
        self.said = self._described(experiment, growing)

    def _described(self, experiment: Experiment, growing: GrowingIdentification) -> LiveIdentification:
        records, result = experiment.records, growing.result
        duration_s = duration_of(records)
        spent_s = growing.spent_s + self._spent_s
        heard_s = max(self._bag.duration_ns * 1e-9, 1e-9)
        drive = records[0].inputs[0]
        samples = {"input": sum(len(one.inputs[0].times_s) for one in records)}
        for one in records:
            for output in one.outputs:
                samples[output.name] = samples.get(output.name, 0) + int(np.count_nonzero(output.is_valid))
        common = replace(
            self.said,
            record_s=duration_s,
            samples=samples,
            started=records[0].start_ns * 1e-9 + drive.span_s[0],
            cost=LiveCost(spent_s / heard_s, growing.seconds_of_last_fit),
            state="waiting" if result is None else self._state(),
            sentence=self._sentence(experiment, growing, duration_s),
        )
        if result is None:
            return common
        model = result.model
        return replace(
            common,
            modes=tuple(
                LiveMode(*map(float, own))
                for own in zip(
                    model.frequencies_hz,
                    model.natural_frequency_sd / (2.0 * np.pi),
                    model.damping_ratios,
                    model.damping_ratio_sd,
                    strict=True,
                )
            ),
            response=self._response(result),
            shape=_shape(model, experiment),
            tests=_tests(result, records),
            aims=tuple(_aim(aim, model, duration_s) for aim in self.aims),
        )

    def _state(self) -> State:
        if self._is_over:
            return "ended"
        return "known" if self._is_known else "growing"

    def _sentence(self, experiment: Experiment, growing: GrowingIdentification, duration_s: float) -> str:
        result, is_full = growing.result, self._has_forgotten(experiment)
        if result is None:
            said = f"No mode is known yet, after {duration_s:.1f} s: {growing.complaint}"
        else:
            count = result.model.n_modes
            said = f"{count} {'mode is' if count == 1 else 'modes are'} known from "
            said += f"{'the newest ' if is_full else ''}{duration_s:.1f} s"
            if self._is_over:
                said = f"The excitation is over: {said}"
            elif self._is_known:
                said += ", as well as was asked: the experiment may stop"
            elif growing.complaint:
                said += f"; the last search ended early ({growing.complaint})"
            if (self._is_over or is_full) and not self._is_known:
                missed = (self._missed(aim, result.model, duration_s) for aim in self.aims)
                said += "".join(f". {text}" for text in missed if text)
        notes = [*experiment.notes, *(result.warnings if result is not None else ())]
        return f"{said}. {' '.join(note.rstrip('.') + '.' for note in notes)}".rstrip().replace("..", ".")

    def _has_forgotten(self, experiment: Experiment) -> bool:
        """Return whether the excitation began before what is remembered of it."""
        begun_ns = max(int(experiment.info.get("start_ns", 0)), self._bag.start_ns)
        return self._bag.start_ns + self._bag.duration_ns - begun_ns > self._bag.memory_s * SECOND_NS

    def _missed(self, aim: Aim, model: ModalModel, duration_s: float) -> str:
        """Return how long a record an aim would take that no further sample meets; nothing where it is met."""
        asked, to_go = f"{aim.name} to {100.0 * aim.relative_sd:.2g} %", aim.seconds_to_go(model, duration_s)
        if not to_go:
            return ""
        if not math.isfinite(to_go):
            return f"{asked} is not reached, for no mode {aim.mode} is known"
        longer = f"{asked} would take a record of about {duration_s + to_go:.3g} s"
        if duration_s + to_go > self._settings.memory:
            return f"{longer}, and {self._settings.memory:g} s are kept: give live.memory more"
        return f"{longer}, at this excitation"

    def _response(self, result: IdentificationResult) -> LiveResponse:
        model = result.model
        hertz = _lines(model, max(result.band.low_hz, 1e-3), result.band.high_hz)
        response = model.frequency_response(2.0 * np.pi * hertz)
        sizes, sds = np.abs(response.response), response.magnitude_sd
        outputs = {
            name: LiveOutput(
                tuple(map(float, sizes[:, j])), tuple(map(float, sds[:, j])), self._seen(name, hertz)
            )
            for j, name in enumerate(model.output_names)
        }
        return LiveResponse("hub/measured", tuple(map(float, hertz)), outputs)

    def _seen(self, name: str, hertz: FloatArray) -> tuple[float | None, ...]:
        """Return the measured magnitudes at the lines next to frequencies, None where there is none near."""
        if name not in self._measured[1]:
            return (None,) * len(hertz)
        lines, sizes = self._measured[1][name]
        nearest = np.argmin(np.abs(lines[None, :] - hertz[:, None]), axis=1)
        spacing = np.maximum(np.gradient(hertz), lines[0])
        is_near = (np.abs(lines[nearest] - hertz) <= 0.5 * spacing) & np.isfinite(sizes[nearest])
        return tuple(
            float(size) if near else None for size, near in zip(sizes[nearest], is_near, strict=True)
        )


def aims_asked(settings: LiveSettings) -> tuple[Aim, ...]:
    """Return the aims that a person has asked for, or raise EstimationError."""
    return aims_of(settings.aims) if settings.aims.strip() else ()


def _measured(record: TimeRecord, longest_s: float = 60.0) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return the lines of every output's response as measured in the newest stretch, and their magnitudes."""
    first, last = record.inputs[0].span_s
    shown = record.between(max(first, last - longest_s), last)
    curves = {}
    for name in shown.output_names:
        try:
            lines = local_polynomial_response(shown, output_names=[name])
        except EstimationError:
            continue  # of scattered stamps there is no such response; the model's is shown alone
        curves[name] = lines.frequencies_hz, np.abs(lines.response).reshape(len(lines.frequencies_hz))
    return curves


def _lines(
    model: ModalModel,
    low_hz: float,
    high_hz: float,
    n_even: int = 120,
    n_about_modes: int = 80,
    half_powers: float = 6.0,
) -> FloatArray:
    """Return the frequencies at which responses are shown [Hz].

    Some lie evenly over their logarithm, and some within so many half-power bandwidths of the modes.
    """
    parts = [np.geomspace(low_hz, high_hz, n_even)]
    n_each = n_about_modes // max(model.n_modes, 1)
    for centre, damping in zip(model.frequencies_hz, model.damping_ratios, strict=True):
        width = min(half_powers * max(damping, 1e-6), 0.5) * centre
        # As the tangent, the lines lie as the phase of the mode turns: evenly.
        turn = np.linspace(-1.0, 1.0, n_each) * math.atan(half_powers)
        parts.append(centre + width * np.tan(turn) / half_powers)
    lines = np.unique(np.concatenate(parts))
    return np.asarray(lines[(lines >= low_hz) & (lines <= high_hz)])


def _shape(model: ModalModel, experiment: Experiment) -> LiveShape | None:
    """Return the modes' shapes at the markers, None where nobody says how high these are."""
    heights = {}
    if experiment.rig is not None:
        markers = experiment.rig.markers
        heights = dict(zip(markers.names, markers.heights, strict=True))
    if not all(name in heights for name in model.output_names):
        return None
    shapes, _ = model.mode_shapes()
    return LiveShape(
        tuple(float(heights[name]) for name in model.output_names),
        tuple(tuple(map(float, shapes[:, k])) for k in range(model.n_modes)),
    )


def _tests(result: IdentificationResult, records: Sequence[TimeRecord]) -> tuple[LiveTest, ...]:
    """Return what was assumed, and what the data say of it; then whether each mode passes the gates."""
    assumed = [
        LiveTest(own.name, own.test, own.p_value if math.isfinite(own.p_value) else None, own.verdict)
        for own in assumptions(result, records)
    ]
    believed = [
        LiveTest(
            f"mode {k + 1} stands out of the noise",
            f"gates of the search{': ' if doubt else ''}{doubt}",
            None,
            "fails" if doubt else "holds",
        )
        for k, doubt in enumerate(result.doubts)
    ]
    return (*assumed, *believed)


def _aim(aim: Aim, model: ModalModel, duration_s: float) -> LiveAim:
    sd, to_go = aim.relative_sd_of(model), aim.seconds_to_go(model, duration_s)
    return LiveAim(
        aim.name,
        aim.relative_sd,
        sd if math.isfinite(sd) else None,
        to_go if math.isfinite(to_go) else None,
        to_go == 0.0,
    )
