"""Gates of the excitation: whether anything moved, at which frequencies, and what that tells of the rig's modes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from beam_ident import IdentificationError, TimeRecord
from beam_ident.data.bandwidth import Band, excited_band
from beam_ident.design.precision import predicted_precision
from beam_ident.design.prediction import LINES_PER_BAND
from beam_ident.modal.structure import ModalStructure
from beam_ident.report.gates import Gate, Verdict
from beam_ident.sensing.still_noise import StillNoise
from beam_ros.arrays import FloatArray

_EXCITE_MORE = (
    "excite this mode more or longer, take noise from the outputs, or record until it has rung down"
)

_KNOWN_MODE = "a frequency known within its own resonance, a damping ratio two deviations from zero"

_BEYOND_A_MODE = 1.1  # of a frequency: where an excitation has passed its mode
_SKIRT = 1.5  # times the end of the excitation: what starts and ends of it still move

Modes = tuple[FloatArray, FloatArray]
"""Natural frequencies [rad/s] and damping ratios."""


def input_band(record: TimeRecord, structure: str) -> Band:
    """Return the band in which a record's input drives modes."""
    drive = record.inputs[0]
    own = ModalStructure(structure)  # type: ignore[arg-type]
    differentiations = own.differentiations if own.is_motion else 0
    first, last = drive.span_s
    busiest = max((output.times_s for output in record.outputs), key=len)
    rate = 1.0 / float(np.median(np.diff(busiest))) if len(busiest) > 1 else 1.0 / (last - first)
    if drive.sigma == 0.0 and (noise := StillNoise.of(drive)).sigma > 0.0:
        drive = replace(drive, sigma=noise.sigma)
    return replace(excited_band(drive, differentiations, last - first, rate), unfolded_hz=0.5 * rate)


def motion_gates(record: TimeRecord, band: Band) -> Iterator[Gate]:
    """Judge whether the input moved, and how far above its noise."""
    drive = record.inputs[0]
    noise = max(drive.sigma, StillNoise.of(drive).sigma)
    size = float(np.std(drive.values))
    above = (
        f", {20.0 * math.log10(size / noise):.0f} dB above its noise of {noise:.2g}" if noise and size else ""
    )
    figure = f"{drive.name} moves by {size:.3g} {drive.unit} (sd){above}"
    expected = "an input that moves by more than its noise"
    if not band.is_excited:
        yield Gate(
            "input moved",
            "failed",
            figure,
            expected,
            "see that the axis was enabled and the excitation ran; without input there is only free decay",
        )
        return
    yield Gate("input moved", "passed", figure, expected)
    yield Gate(
        "excited band",
        "passed",
        f"{band.low_hz:.3g} to {band.high_hz:.3g} Hz",
        "the frequencies of the modes that are wanted",
    )


def mode_gates(
    records: Sequence[TimeRecord],
    structure: str,
    band: Band,
    modes: Modes | None,
    noise_sd: Mapping[str, float],
    spacing_hz: float | None,
    clock_rate_sd: float,
) -> Iterator[Gate]:
    """Judge what the record tells of every mode of the rig that it can show.

    Parameters
    ----------
    records : sequence of TimeRecord
    structure : str
    band : Band -- of the excitation
    modes : Modes or None -- by the rig's theory
    noise_sd : mapping -- floor of every output; one that is not known, NaN, tells nothing
    spacing_hz : float or None -- between the frequencies of the excitation, where its recipe is known
    clock_rate_sd : float -- how well the outputs' clock is known against the input's
    """
    first, last = records[0].inputs[0].span_s
    step_hz = max(1.0 / (last - first), spacing_hz or 0.0)
    if modes is None:
        yield Gate(
            "resolution",
            "not judged",
            f"frequencies {step_hz:.3g} Hz apart, {(last - first):.3g} s",
            f"half-power bands of {LINES_PER_BAND:g} times that, 2 zeta f, for a frequency response; a rig file "
            "tells which modes there are",
        )
        return
    low, high = band.reach_hz
    omegas, zetas = modes
    hertz = omegas / (2.0 * math.pi)
    yield from _folded_modes(hertz, band)
    shown = (hertz > low) & (hertz < high)
    if not np.any(shown) and band.is_excited:
        yield Gate(
            "modes in the band",
            "failed",
            f"none of {', '.join(f'{f:.3g}' for f in hertz)} Hz in {band.low_hz:.3g} to {band.high_hz:.3g} Hz",
            "at least one mode of the rig",
            "excite where the modes are (`beam design`), or give the rig file of this experiment",
        )
        return
    if not band.is_excited:
        return
    yield from _shown_modes(records, structure, omegas[shown], zetas[shown], noise_sd, step_hz, clock_rate_sd)


def _shown_modes(
    records: Sequence[TimeRecord],
    structure: str,
    omegas: FloatArray,
    zetas: FloatArray,
    noise_sd: Mapping[str, float],
    step_hz: float,
    clock_rate_sd: float,
) -> Iterator[Gate]:
    """Judge how well the best estimator would know modes in the band, given the outputs whose noise is known."""
    known = {name: sd for name, sd in noise_sd.items() if math.isfinite(sd) and sd > 0.0}
    telling = [
        record.select(own)
        for record in records
        if (own := [name for name in record.output_names if name in known])
    ]
    hertz = omegas / (2.0 * math.pi)
    widths = [
        f"half-power band of {2.0 * zeta * f:.3g} Hz with {2.0 * zeta * f / step_hz:.2g} lines; "
        for f, zeta in zip(hertz, zetas, strict=True)
    ]
    if not telling:
        unknown = (
            "how far it stands out of the outputs' noise is not known: too many samples are missing. "
            "`beam identify` says"
        )
        for f, width in zip(hertz, widths, strict=True):
            yield Gate(f"mode at {f:.3g} Hz", "not judged", width + unknown, _KNOWN_MODE)
        return
    try:
        found = predicted_precision(
            telling,
            structure,  # type: ignore[arg-type]
            omegas,
            zetas,
            known,
            clock_rate_sd,
        )
    except IdentificationError as err:
        yield Gate("resolution", "failed", str(err), "a record that can be fitted", "record longer")
        return
    sds_hz = found.omega_sd / (2.0 * math.pi)
    is_seen = np.isfinite(sds_hz) & (found.zeta_sd < zetas)
    is_known = (sds_hz < zetas * hertz) & (found.zeta_sd < 0.5 * zetas)
    otherwise: Verdict = "doubtful" if np.any(found.omega_sd < zetas * omegas) else "failed"
    for k, f in enumerate(hertz):
        share = 100.0 * float(found.zeta_sd[k] / zetas[k])
        figure = (
            f"frequency to {sds_hz[k]:.2g} Hz, damping ratio to {share:.2g} % of it at best"
            if is_seen[k]
            else "no output shows it above its noise"
        )
        verdict: Verdict = "passed" if is_known[k] else otherwise
        remedy = "" if is_known[k] else _EXCITE_MORE
        yield Gate(f"mode at {f:.3g} Hz", verdict, widths[k] + figure, _KNOWN_MODE, remedy)


def _folded_modes(hertz: FloatArray, band: Band) -> Iterator[Gate]:
    """Name the modes beyond the excitation that the outputs show somewhere else, inside of it."""
    rate = 2.0 * band.unfolded_hz
    for f in hertz[(hertz > max(band.reach_hz[1], band.unfolded_hz)) & (hertz < _SKIRT * band.high_hz)]:
        alias = abs(f - rate * round(f / rate))
        if band.is_excited and band.low_hz < alias < band.high_hz:
            yield Gate(
                f"mode at {f:.3g} Hz",
                "doubtful",
                f"not excited, and looks like {alias:.3g} Hz in {rate:.3g} samples a second: what little of it moves "
                "lies among the frequencies that are excited",
                "every mode near the excitation below half the outputs' rate, or excited itself",
                f"excite up to {_BEYOND_A_MODE * f:.3g} Hz, or film at more than {2.0 * f:.3g} frames a second; "
                f"believe no mode near {alias:.3g} Hz",
            )
