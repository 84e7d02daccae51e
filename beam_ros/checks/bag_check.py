"""Whether a bag can be identified, and if not why: all gates of a bag in one object, and as a table.

Nothing is fitted. What a gate expects comes from the data and from physics: an error of time counts by what it does
to the outputs, a gap by how well it can be bridged, a mode by the precision that the best estimator would have.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from beam_ident import IdentificationError
from beam_ident.report.gates import Gate
from beam_ros.bags.errors import BagError, BagNotFoundError, BagTruncatedError, NotABagError
from beam_ros.bags.reading import Bag
from beam_ros.checks.excitation_gates import Modes, input_band, mode_gates, motion_gates
from beam_ros.checks.signal_gates import (
    damage_gate,
    floors,
    input_gates,
    limit_gates,
    loss_gates,
    noise_gates,
    place_gate,
    unit_gate,
)
from beam_ros.checks.stamp_gates import TimingCosts, clock_gates, jump_gate, order_gates, rate_gates
from beam_ros.errors import ParameterFileError
from beam_ros.excitation.recipes import recipe_of_rig
from beam_ros.files.formats import is_column_file
from beam_ros.offline.loading.described_rig import theoretical_modes
from beam_ros.offline.loading.experiment import Experiment, experiment_of, load_experiment
from beam_ros.offline.loading.options import FitOptions
from beam_ros.process.remote_paths import AnyPath
from beam_ros.rig.rig import Rig
from beam_ros.signals.fields import find_topic

_WIDTH = 118


@dataclass(frozen=True)
class BagCheck:
    """What a bag is worth.

    Attributes
    ----------
    path : Path or RemotePath -- the bag
    gates : tuple of Gate
    notes : tuple of str -- what was said while it was read
    experiment : Experiment or None -- what was read, None where nothing can be identified
    """

    path: AnyPath
    gates: tuple[Gate, ...]
    notes: tuple[str, ...] = ()
    experiment: Experiment | None = None

    @property
    def looked(self) -> tuple[tuple[Gate, ...], Experiment | None]:
        """The gates and what was read, for an identification that follows."""
        return self.gates, self.experiment

    @property
    def can_be_identified(self) -> bool:
        """Whether no gate failed."""
        return not any(gate.verdict == "failed" for gate in self.gates)

    @property
    def reasons(self) -> tuple[str, ...]:
        """What failed, else what is doubtful, in a sentence each."""
        worst = "doubtful" if self.can_be_identified else "failed"
        return tuple(f"{gate.name}: {gate.figure}" for gate in self.gates if gate.verdict == worst)

    @property
    def verdict(self) -> str:
        """The answer in one line."""
        if not self.can_be_identified:
            return f"can be identified: no, because of {'; '.join(self.reasons)}"
        if not self.reasons:
            return "can be identified: yes"
        names = ", ".join(gate.name for gate in self.gates if gate.verdict == "doubtful")
        return f"can be identified: yes, but look at {names}"

    def to_dict(self) -> dict[str, Any]:
        """Return plain types."""
        return {
            "bag": str(self.path),
            "can_be_identified": self.can_be_identified,
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "gates": [gate.to_dict() for gate in self.gates],
            "notes": list(self.notes),
        }


def check_bag(
    path: AnyPath,
    rig: Rig | None = None,
    options: FitOptions | None = None,
    *,
    start_s: float | None = None,
    end_s: float | None = None,
) -> BagCheck:
    """Check a bag before anything is fitted to it.

    Parameters
    ----------
    path : Path or RemotePath -- the bag
    rig : Rig, optional -- None: the rig that the bag itself describes, if it does
    options : FitOptions, optional -- signals, segments, structure and hold are taken from it
    start_s, end_s : float, optional -- only what lies between these times after the first message, or row [s]

    Returns
    -------
    BagCheck -- also of a bag that is damaged, or holds nothing that can be identified

    Raises
    ------
    BagNotFoundError, NotABagError
        There is no bag at the path.
    UsageError
        A signal names a field that is not there.
    """
    options = options or FitOptions()
    gates: list[Gate] = []
    try:
        if is_column_file(path):
            experiment = load_experiment(path, rig, options.structure, options, start_s=start_s, end_s=end_s)
            gates.append(Gate("file", "passed", "every row has its time", "rows in the order of their times"))
            gates += _gates(None, experiment, options)
            return BagCheck(path, tuple(gates), experiment.notes, experiment)
        with Bag(path, start_s=start_s, end_s=end_s) as bag:
            damage = list(bag.damage())
            gates.append(_file_gate(damage, path))
            experiment = experiment_of(bag, rig, options.structure, options)
            gates += _gates(bag, experiment, options)
    except (BagNotFoundError, NotABagError):
        raise
    except BagTruncatedError as err:
        gates.append(Gate("file", "failed", str(err), "a whole bag", f"beam recover {path}"))
        return BagCheck(path, tuple(gates))
    except (BagError, IdentificationError) as err:
        remedy = (
            "record with the nodes running that publish it, or name other signals with --input and --output"
        )
        gates.append(Gate("content", "failed", str(err), "input and outputs that overlap in time", remedy))
        return BagCheck(path, tuple(gates))
    return BagCheck(path, tuple(gates), experiment.notes, experiment)


def _file_gate(damage: list[str], path: AnyPath) -> Gate:
    if damage:
        return Gate("file", "doubtful", "; ".join(damage), "a whole bag", f"beam recover {path}")
    return Gate("file", "passed", "whole", "a whole bag")


def _bag_gates(bag: Bag, experiment: Experiment, options: FitOptions, costs: TimingCosts) -> Iterator[Gate]:
    """Yield the gates that look at the messages of a bag."""
    signals = options.signals
    named = [own.topic for own in (signals.drive, *signals.outputs) if own is not None]
    own_topics = [
        topic
        for topic, is_used in (
            ("hub/measured", signals.drive is None),
            ("hub/applied", signals.drive is None),
            ("beam/displacement", not signals.outputs),
        )
        if is_used and bag.count(topic)
    ]
    topics = list(dict.fromkeys(find_topic(bag, topic)[0] for topic in (*own_topics, *named)))
    yield from order_gates(bag, topics, experiment.record.start_ns)
    if signals.drive is None:
        yield from clock_gates(bag, costs)


def _gates(bag: Bag | None, experiment: Experiment, options: FitOptions) -> Iterator[Gate]:
    records, rig, structure = experiment.records, experiment.rig, experiment.structure
    signals = options.signals
    outputs = [own for record in records for own in record.outputs]
    noise_sd = floors(outputs)
    if bag is not None:
        yield from _bag_gates(bag, experiment, options, TimingCosts(outputs, noise_sd))
        # The rows of a file share one clock, and only whole rows may be missing in it.
        yield jump_gate(records)
    yield from rate_gates(outputs, rig, not signals.outputs)
    of_metres = [noise_sd[own.name] for own in records[0].outputs if noise_sd[own.name] > 0.0]
    yield from input_gates(records[0], min(of_metres, default=math.inf))
    yield from loss_gates(outputs)
    for record in records:
        yield damage_gate(record)
    yield from noise_gates(outputs, noise_sd)
    yield unit_gate(records[-1], structure)
    yield place_gate(records[0], rig, structure)
    yield from limit_gates(records[-1], rig)
    band = input_band(records[0], structure)
    yield from motion_gates(records[0], band)
    modes: Modes | None = theoretical_modes(rig, structure) if rig is not None else None
    spacing_hz = _spacing_hz(experiment, band.high_hz)
    rate_sd = (options.clock or experiment.clock_rate).sd
    yield from mode_gates(records, structure, band, modes, noise_sd, spacing_hz, min(rate_sd, 1.0))


def _spacing_hz(experiment: Experiment, near_hz: float) -> float | None:
    """Return how far apart the excitation's own frequencies are [Hz], None where no recipe is known."""
    if experiment.rig is None or "rig" not in experiment.info:
        return None
    try:
        recipe = recipe_of_rig(Rig.from_nested(experiment.info["rig"]))
    except (ParameterFileError, ValueError, AttributeError):
        return None  # of another version: the record's own length stands
    return float(recipe.line_spacing_hz(near_hz))


def gates_of_bag(path: AnyPath, rig: Rig | None, options: FitOptions) -> tuple[Gate, ...]:
    """Return the gates of ``check_bag`` alone."""
    return check_bag(path, rig, options).gates


def format_check(check: BagCheck) -> str:
    """Format the verdict and below it the gates as a table for a terminal."""
    width = max((len(gate.name) for gate in check.gates), default=0)
    lines = [check.verdict, ""]
    for gate in check.gates:
        head = f"{gate.verdict:<10}  {gate.name:<{width}}  "
        lines.append(
            textwrap.fill(
                gate.figure,
                _WIDTH,
                initial_indent=head,
                subsequent_indent=" " * len(head),
                break_on_hyphens=False,
            )
        )
        if gate.verdict in ("doubtful", "failed"):
            said = f"expected {gate.expected}" + (f"; {gate.remedy}" if gate.remedy else "")
            indent = " " * len(head)
            lines.append(textwrap.fill(said, _WIDTH, initial_indent=indent, subsequent_indent=indent))
    return "\n".join(lines)
