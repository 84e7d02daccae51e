"""Say what a bag holds: topics, samples and gaps, clocks, sequences, excitation; status 1 if it is damaged."""

from __future__ import annotations

import argparse
import math

from beam_ros.bags.reading import Bag
from beam_ros.bags.summary import BagInfo, summarise
from beam_ros.cli.options import add_bag, read_span
from beam_ros.excitation.recipes import describe_excitation
from beam_ros.process.remote_paths import any_path
from beam_ros.process.strict_json import strict_json

_LONG = ("rig", "calibration")
"""Parts of the provenance that only --json prints."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    add_bag(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    start_s, end_s = read_span(arguments)
    with Bag(any_path(arguments.bag), start_s=start_s, end_s=end_s) as bag:
        info = summarise(bag)
    print(strict_json(info.to_dict(), indent=2) if arguments.json else _text(info))
    return 1 if info.damage else 0


def _text(info: BagInfo) -> str:
    lines = [
        f"{info.path}: {info.message_count} messages in {info.duration_ns * 1e-9:.1f} s ({info.storage}), "
        f"{info.apparatus.date(info.start_ns)}",
        *([info.apparatus.sentence] if info.apparatus.is_simulated else []),
        "",
    ]
    width = max((len(topic.name) for topic in info.topics), default=0)
    lines += [f"  {t.name:<{width}}  {t.message_count:>8}  {t.type_name}" for t in info.topics]
    lines.append("")
    for signal in info.signals:
        if not signal.samples:
            lines.append(
                f"  {signal.topic}: {signal.unreadable} messages, none as the rig's nodes publish it"
            )
            continue
        seen = f", {signal.unreadable} messages unreadable" if signal.unreadable else ""
        if signal.names:
            unseen = zip(signal.names, signal.unseen, strict=True)
            seen += "; not seen: " + ", ".join(f"{name} {count}" for name, count in unseen)
        lines.append(
            f"  {signal.topic}: {signal.samples} samples over {signal.duration_s:.3f} s at {signal.rate_hz:.3f} Hz, "
            f"{signal.gaps} gaps, {signal.lost} lost{seen}"
        )
    for clock in info.clocks:
        if not math.isnan(clock.rate_ppm):
            lines.append(
                f"  clock epoch {clock.epoch}: {clock.rate_ppm:+.3f} ppm against the host, residual "
                f"{clock.residual_ns * 1e-3:.1f} us, median round trip {clock.median_rtt_ns * 1e-3:.0f} us"
            )
    lines += [f"  sequence {sequence}" for sequence in info.sequences]
    if info.excitation:
        lines.append(f"  excitation {describe_excitation(info.excitation)}")
    lines += [
        f"  damaged: {damage}; `beam recover {info.path}` saves what can be read" for damage in info.damage
    ]
    shown = [f"{name} {text}" for name, text in info.provenance.items() if name not in _LONG]
    if shown:
        lines.append(f"  recorded with {', '.join(shown)}")
    if info.remark:
        lines.append(f"  {info.remark}")
    return "\n".join(lines)
