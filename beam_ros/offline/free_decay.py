"""Modes of a free decay in a file of columns, which has no input: what was let go, or struck, and then rings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beam_ident import FreeDecay, fit_free_decay
from beam_ros.errors import UsageError
from beam_ros.files.formats import is_column_file
from beam_ros.interfaces.rig_parameters import IdentifierSettings
from beam_ros.offline.loading.options import listed, paths
from beam_ros.signals.descriptions import Signals
from beam_ros.signals.file_columns import NO_INPUT, read_file_outputs
from beam_ros.signals.records import output_signal

_OF_INPUTS = (
    "report",
    "validate",
    "axis",
    "amplitude",
    "best_linear",
    "segments",
    "orders",
    "without",
    "signals",
)
"""Parameters that ask for a model with an input, or for parts of one."""


def identify_decay(
    settings: IdentifierSettings, start_s: float | None = None, end_s: float | None = None
) -> dict[str, Any]:
    """Return the modes of a free decay in plain numbers.

    Parameters
    ----------
    settings : IdentifierSettings -- whose ``input`` is ``NO_INPUT``
    start_s, end_s : float, optional -- the part that rings freely, after the file's first row [s]

    Raises
    ------
    UsageError
        Not one file, no output, or something is asked for that needs an input.
    ColumnFileError
        The file cannot be read, lacks a column or a unit, or has times that cannot be right.
    IdentificationError
        Nothing rings.
    """
    found = paths(settings.bag)
    if len(found) != 1 or not is_column_file(found[0]):
        raise UsageError(
            f"--input {NO_INPUT} with {settings.bag}: expected one file of columns; a bag's input is its hub, also "
            "where it rests: leave --input out"
        )
    asked = [name for name in _OF_INPUTS if getattr(settings, name)]
    if asked:
        flag = f"--{asked[0].replace('_', '-')}"
        raise UsageError(
            f"{flag} with --input {NO_INPUT}: a free decay gives frequencies, damping ratios and amplitudes, but no "
            f"model from an input to outputs; leave {flag} out"
        )
    notes: list[str] = []
    sampled = read_file_outputs(
        Path(str(found[0])),
        Signals.of("", listed(settings.outputs)),
        settings.time,
        notes,
        start_s=start_s,
        end_s=end_s,
    )
    origin_ns = int(sampled[0][1].stamps_ns[0])
    decay = fit_free_decay(
        [output_signal(source, samples, origin_ns).signal for source, samples in sampled],
        settings.modes or None,
        **({"max_modes": settings.max_modes} if settings.max_modes else {}),
    )
    return _described(decay, notes)


def _described(decay: FreeDecay, notes: list[str]) -> dict[str, Any]:
    modes = [
        {
            "frequency_hz": float(decay.frequencies_hz[k]),
            "frequency_sd_hz": float(decay.frequency_sd_hz[k]),
            "damping_ratio": float(decay.damping_ratios[k]),
            "damping_ratio_sd": float(decay.damping_ratio_sd[k]),
            "amplitudes": {
                name: float(abs(size))
                for name, size in zip(decay.output_names, decay.amplitudes[:, k], strict=True)
            },
        }
        for k in range(len(decay.natural_frequencies))
    ]
    return {
        "outputs": list(decay.output_names),
        "start_s": decay.start_s,
        "modes": modes,
        "noise_sd": dict(zip(decay.output_names, map(float, decay.noise_sd), strict=True)),
        "converged": decay.converged,
        "warnings": list(decay.warnings),
        "notes": notes,
        "decay": decay.to_dict(),
    }


def format_decay(content: Mapping[str, Any]) -> str:
    """Format modes of a free decay as a table for a terminal."""
    lines = [f"free decay from {content['start_s']:.3f} s on, of {', '.join(content['outputs'])}", ""]
    lines.append("mode   frequency [Hz]           damping ratio")
    for number, mode in enumerate(content["modes"], 1):
        lines.append(
            f"{number:>4}   {mode['frequency_hz']:>10.5f} +- {mode['frequency_sd_hz']:<8.2g}  "
            f"{mode['damping_ratio']:>9.6f} +- {mode['damping_ratio_sd']:.2g}"
        )
    lines += [f"note: {line}" for line in (*content["notes"], *content["warnings"])]
    return "\n".join(lines)
