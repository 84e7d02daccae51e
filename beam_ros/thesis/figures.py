"""The figures of the reference work, drawn from what was measured and estimated; one function each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from beam_ident import EstimationError, local_polynomial_response
from beam_ident.figures.canvas import COLOURS, MEASURED, MODEL, REFERENCE, axes_grid, drawn, stacked_axes
from beam_ident.quantities import with_uncertainty
from beam_ros.arrays import ComplexArray, FloatArray
from beam_ros.offline.loading.experiment import Experiment
from beam_ros.rig.rig import Rig
from beam_ros.thesis.data import AtPoint, ThesisData

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BAND_POINTS = 900


def chirp_simulated(data: ThesisData) -> Figure:
    """Draw figure 4.1: hub and displacements under the chirp, by theory."""
    sim = data.simulated
    figure, axes = stacked_axes(3, 5.6)
    axes[0].plot(*drawn(sim.times_s, 1e3 * sim.hub), color=REFERENCE, linewidth=0.7)
    axes[0].set_ylabel("hub [mm]")
    for k, (axis, at) in enumerate(zip(axes[1:], data.points, strict=True)):
        axis.plot(*drawn(sim.times_s, 1e3 * sim.displacements[:, k]), color=COLOURS[k], linewidth=0.6)
        axis.set_ylabel(f"u at {at.point.label} [mm]")
    axes[-1].set_xlabel("time [s]")
    return figure


def responses_simulated(data: ThesisData) -> Figure:
    """Draw figure 4.2: frequency responses by theory, from the hub's position."""
    figure, axes = stacked_axes(2, 5.0)
    rig = data.rigs["E1"]
    hertz = _grid(data, 1.0, 200.0)
    for k, at in enumerate(data.points):
        response = _theory(rig, at.point.height, hertz)
        axes[0].semilogy(hertz, np.abs(response), color=COLOURS[k], label=f"u at {at.point.label} over hub")
        axes[1].plot(hertz, np.degrees(np.angle(response)), color=COLOURS[k], linewidth=0.8)
    for axis in axes:
        axis.set_xscale("log")
        axis.axvline(0.5 * rig.camera.rate, color=MEASURED, linestyle=":", linewidth=1.0)
    axes[0].set_ylabel("magnitude")
    axes[0].legend(frameon=False, fontsize=8)
    axes[1].set_ylabel("phase [deg]")
    axes[1].set_xlabel("frequency [Hz]")
    return figure


def measured_over_simulated(data: ThesisData) -> Figure:
    """Draw figure 4.3: what E1 measured over the simulation, and the difference."""
    figure, axes = axes_grid(4, 1, (9.0, 7.4), sharex=True, height_ratios=(3, 1, 3, 1))
    for k, at in enumerate(data.points):
        times, measured, simulated = _aligned(data, k)
        top, low = axes[2 * k, 0], axes[2 * k + 1, 0]
        top.plot(*drawn(times, 1e3 * measured), color=MEASURED, linewidth=1.4, label="measured")
        top.plot(*drawn(times, 1e3 * simulated), color=MODEL, linewidth=0.6, label="simulated")
        top.set_ylabel(f"u at {at.point.label} [mm]")
        low.plot(*drawn(times, 1e6 * (measured - simulated)), color=COLOURS[0], linewidth=0.5)
        low.set_ylabel("difference [µm]")
    axes[0, 0].legend(frameon=False, fontsize=8, ncols=2)
    axes[-1, 0].set_xlabel("time from the start of the sequence [s]")
    return figure


def simulation_fit_percent(data: ThesisData, k: int) -> float:
    """Return the fit of the simulation without any fitted parameter at a point [%]."""
    _, measured, simulated = _aligned(data, k)
    offset = float(np.mean(measured - simulated))
    off = float(np.linalg.norm(measured - simulated - offset))
    return 100.0 * (1.0 - off / float(np.linalg.norm(measured - np.mean(measured))))


def rig_drawing(data: ThesisData) -> Figure:
    """Draw the rig, in place of the photographs of figures 4.4 to 4.7."""
    from matplotlib.patches import Rectangle

    rig = data.rigs["E1"]
    figure, axes = axes_grid(1, 1, (5.6, 5.2))
    axis = axes[0, 0]
    axis.grid(False)
    length, travel = 1e3 * rig.beam.length, 1e3 * rig.hub.travel
    axis.add_patch(Rectangle((-0.5 * travel - 8.0, -34.0), travel + 16.0, 4.0, color=MEASURED))
    axis.add_patch(Rectangle((-16.0, -30.0), 32.0, 30.0, color=REFERENCE))
    axis.plot([0.0, 0.0], [0.0, length], color="#1f2937", linewidth=2.0)
    z = np.linspace(0.0, length, 100)
    bent = rig.beam_model().shape(1e-3 * z)[:, 0]
    axis.plot(22.0 * bent / bent[-1], z, color=MEASURED, linewidth=1.0, linestyle="--")
    for name, height in zip(rig.markers.names, rig.markers.heights, strict=True):
        axis.plot(0.0, 1e3 * height, "o", color=MODEL, markersize=7.0)
        axis.annotate(
            f"{name}, {1e3 * height:g} mm", (-14.0, 1e3 * height), ha="right", va="center", fontsize=9
        )
    axis.annotate(
        "",
        (0.5 * travel, -15.0),
        (-0.5 * travel, -15.0),
        arrowprops={"arrowstyle": "<->", "color": "#1f2937"},
    )
    axis.annotate(f"hub, {rig.hub.mass:g} kg, travel {travel:g} mm", (0.0, -46.0), ha="center", fontsize=9)
    axis.annotate("x", (0.5 * travel + 2.0, -18.0), fontsize=9)
    axis.set_xlim(-0.5 * travel - 14.0, 0.5 * travel + 24.0)
    axis.set_ylim(-52.0, length + 14.0)
    axis.set_aspect("equal")
    axis.set_xlabel("x [mm]")
    axis.set_ylabel("height above the clamp [mm]")
    return figure


def calibration_lines(data: ThesisData) -> Figure:
    """Draw figure 4.8: pixels over millimetres for every marker, and what the lines leave over."""
    fit = data.calibration
    assert fit is not None
    figure, axes = axes_grid(1, 2, (9.0, 3.6))
    left, right = axes[0]
    names = data.rigs["E1"].markers.names
    for k, (name, line, points) in enumerate(zip(names, fit.lines, fit.points, strict=True)):
        colour = COLOURS[k % len(COLOURS)]
        x = np.array([point.reference_m for point in points])
        left.plot([point.u_px for point in points], 1e3 * x, "o", color=colour, markersize=4.0, label=name)
        ends = np.array([x.min(), x.max()])
        left.plot(line.intercept + line.slope * ends, 1e3 * ends, color=colour, linewidth=0.8)
        right.errorbar(
            1e3 * x,
            1e3 * line.residual_px,
            [1.96e3 * point.u_sd_px for point in points],
            fmt="o",
            color=colour,
            markersize=3.5,
            linewidth=0.8,
        )
    left.set_xlabel("column in the image [px]")
    left.set_ylabel("reference sensor [mm]")
    left.legend(frameon=False, fontsize=8)
    right.axhline(0.0, color=MEASURED, linewidth=0.8)
    right.set_xlabel("reference sensor [mm]")
    right.set_ylabel("residual [10$^{-3}$ px], 95 %")
    return figure


def record_over_time(experiment: Experiment, data: ThesisData) -> Figure:
    """Draw figures 4.9 and 4.11: the input, both outputs, and what the beam adds to the hub."""
    record = experiment.record
    drive = record.inputs[0]
    figure, axes = axes_grid(4, 1, (9.0, 6.6), sharex=True)
    axes[0, 0].plot(*drawn(drive.times_s, 1e3 * drive.values), color=REFERENCE, linewidth=0.6)
    axes[0, 0].set_ylabel("hub [mm]")
    for k, at in enumerate(data.points):
        output = record.output(at.point.name)
        axes[k + 1, 0].plot(output.times_s, 1e3 * output.values, color=COLOURS[k], linewidth=0.6)
        axes[k + 1, 0].set_ylabel(f"y{at.point.number} [mm]")
    lower = record.output(data.points[0].point.name)
    bent = lower.values - np.interp(lower.times_s, drive.times_s, drive.values)
    axes[3, 0].plot(lower.times_s, 1e6 * (bent - np.mean(bent)), color=COLOURS[0], linewidth=0.5)
    axes[3, 0].set_ylabel(f"y{data.points[0].point.number} less hub [µm]")
    axes[3, 0].set_xlabel("time [s]")
    return figure


def two_resonances(data: ThesisData) -> Figure:
    """Draw figure 4.10: the measured response of the deflection to the chirp, with the identified frequencies."""
    result = data.modal["E1"]
    figure, axes = stacked_axes(1, 3.6)
    axis = axes[0]
    for k, at in enumerate(data.points):
        measured = measured_response(data, "E1", at.point.name)
        if measured is None:
            continue
        hertz, response = measured
        axis.semilogy(
            hertz,
            np.abs(response - 1.0),
            ".",
            color=COLOURS[k],
            markersize=3.0,
            label=f"deflection at {at.point.label}",
        )
    for frequency, sd in zip(result.model.frequencies_hz, result.model.natural_frequency_sd, strict=True):
        axis.axvline(frequency, color=MODEL, linewidth=0.9)
        axis.annotate(
            f" {with_uncertainty(frequency, sd / (2.0 * math.pi))} Hz",
            (frequency, 0.97),
            xycoords=("data", "axes fraction"),
            va="top",
            fontsize=8,
        )
    axis.set_xlim(0.0, _highest(data))
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("deflection over hub")
    axis.legend(frameon=False, fontsize=8, loc="lower right")
    return figure


def spectra(data: ThesisData) -> Figure:
    """Draw figure 4.12: amplitude spectra of the multisine's input and outputs, with the floor of the noise."""
    record, result = data.experiments["E2"].record, data.modal["E2"]
    figure, axes = stacked_axes(2, 5.0)
    reference = record.output(data.points[0].point.name)
    drive = record.inputs[0]
    hertz, size = _spectrum(reference.times_s, np.interp(reference.times_s, drive.times_s, drive.values))
    axes[0].semilogy(hertz, 1e6 * size, color=REFERENCE, linewidth=0.8)
    axes[0].set_ylabel("hub [µm]")
    for k, at in enumerate(data.points):
        output, fit = record.output(at.point.name), result.output(at.point.name)
        hertz, size = _spectrum(output.times_s, output.values)
        axes[1].semilogy(hertz, 1e6 * size, color=COLOURS[k], linewidth=0.8, label=f"y{at.point.number}")
        hertz, floor = _spectrum(fit.times_s, fit.residuals)
        axes[1].semilogy(hertz, 1e6 * floor, color=COLOURS[k], linewidth=0.4, alpha=0.6)
    axes[1].set_ylabel("outputs, residuals [µm]")
    axes[1].legend(frameon=False, fontsize=8)
    axes[1].set_xlabel("frequency [Hz]")
    return figure


def bode(data: ThesisData, at: AtPoint) -> Figure:
    """Draw figures 4.13 and 4.14: the deflection over the hub, by every model, with bands, measurement and theory."""
    figure, axes = stacked_axes(2, 5.4)
    hertz = _grid(data, 1.0, _highest(data))
    omegas = 2.0 * math.pi * hertz
    measured = measured_response(data, "E2", at.point.name)
    if measured is not None:
        axes[0].semilogy(
            measured[0], np.abs(measured[1] - 1.0), ".", color=MEASURED, markersize=3.0, label="measured, E2"
        )
        # The turn of theory: else noise throws points about -180 degrees to the other end of the axis.
        near = _theory(data.rigs["E1"], at.point.height, measured[0]) - 1.0
        phase = np.angle(near) + np.angle((measured[1] - 1.0) / near)
        axes[1].plot(measured[0], np.degrees(phase), ".", color=MEASURED, markersize=2.5)
    for k, (name, model) in enumerate(at.transfer_functions.items()):
        response, sd = model.frequency_response(omegas)
        # The camera's latency is no part of the beam.
        response = response * np.exp(1j * omegas * model.delay)
        _curve(axes, hertz, response - 1.0, sd, COLOURS[k], f"transfer function, {name}")
    found = data.modal["E1"].model
    place = found.output_names.index(at.point.name)
    own = found.frequency_response(omegas)
    _curve(
        axes,
        hertz,
        own.response[:, place] - found.gains[place],
        own.magnitude_sd[:, place],
        COLOURS[2],
        "all points at once, E1",
    )
    theory = _theory(data.rigs["E1"], at.point.height, hertz) - 1.0
    axes[0].semilogy(hertz, np.abs(theory), color="#1f2937", linewidth=0.8, linestyle="--", label="theory")
    axes[1].plot(hertz, np.degrees(np.angle(theory)), color="#1f2937", linewidth=0.8, linestyle="--")
    smallest = float(np.min(np.abs(theory)))
    axes[0].set_ylim(bottom=0.3 * smallest)
    axes[0].set_ylabel("deflection over hub")
    axes[0].legend(frameon=False, fontsize=8)
    axes[1].set_ylabel("phase [deg]")
    axes[1].set_xlabel("frequency [Hz]")
    return figure


def prediction(data: ThesisData, at: AtPoint) -> Figure:
    """Draw figures 4.15 and 4.16: the model from E1 on the validation data V2, and the residual."""
    output = data.validations[at.point.name, "E1", "V2"].output(at.point.name)
    figure, axes = axes_grid(2, 1, (9.0, 4.6), sharex=True, height_ratios=(3, 1))
    top, low = axes[:, 0]
    times = output.times_s
    top.plot(*drawn(times, 1e3 * output.measured), color=MEASURED, linewidth=1.4, label="measured, V2")
    top.plot(
        *drawn(times, 1e3 * output.simulated),
        color=MODEL,
        linewidth=0.6,
        label="predicted by the model from E1",
    )
    top.set_ylabel(f"y{at.point.number} [mm]")
    top.legend(frameon=False, fontsize=8, ncols=2)
    low.plot(*drawn(times, 1e6 * output.residuals), color=COLOURS[0], linewidth=0.5)
    low.set_ylabel("residual [µm]")
    low.set_xlabel("time [s]")
    return figure


def step_responses(data: ThesisData) -> Figure:
    """Draw figure 4.17: the measured step under every model's response, with the residuals."""
    figure, axes = axes_grid(4, 1, (9.0, 7.4), sharex=True, height_ratios=(3, 1.3, 3, 1.3))
    for k, at in enumerate(data.points):
        top, low = axes[2 * k, 0], axes[2 * k + 1, 0]
        for number, (name, _) in enumerate(at.models.items()):
            output = data.validations[at.point.name, name, "S"].output(at.point.name)
            if number == 0:
                top.plot(
                    output.times_s, 1e3 * output.measured, color=MEASURED, linewidth=1.6, label="measured"
                )
            colour = COLOURS[number]
            top.plot(
                output.times_s,
                1e3 * output.simulated,
                color=colour,
                linewidth=0.7,
                label=f"model from {name}",
            )
            low.plot(output.times_s, 1e6 * output.residuals, color=colour, linewidth=0.5)
        top.set_ylabel(f"y{at.point.number} [mm]")
        low.set_ylabel("residual [µm]")
    axes[0, 0].legend(frameon=False, fontsize=8, ncols=3)
    axes[-1, 0].set_xlabel("time [s]")
    return figure


def measured_response(data: ThesisData, source: str, name: str) -> tuple[FloatArray, ComplexArray] | None:
    """Return frequencies [Hz] and the measured response from hub to output, or None where stamps are irregular."""
    try:
        found = local_polynomial_response(data.experiments[source].record.select((name,)))
    except EstimationError:
        return None
    series = found.series()[0]
    excitation = data.rigs[source].excitation
    driven = (series.frequencies_hz >= excitation.start_frequency) & (
        series.frequencies_hz <= excitation.end_frequency
    )
    return series.frequencies_hz[driven], series.response[driven]


DRAWN: Mapping[str, Callable[[ThesisData], Any]] = {
    "Figure 4.1": chirp_simulated,
    "Figure 4.2": responses_simulated,
    "Figure 4.3": measured_over_simulated,
    "Figure 4.4": rig_drawing,
    "Figure 4.8": calibration_lines,
    "Figure 4.9": lambda data: record_over_time(data.experiments["E1"], data),
    "Figure 4.10": two_resonances,
    "Figure 4.11": lambda data: record_over_time(data.experiments["E2"], data),
    "Figure 4.12": spectra,
    "Figure 4.13": lambda data: bode(data, data.points[0]),
    "Figure 4.14": lambda data: bode(data, data.points[1]),
    "Figure 4.15": lambda data: prediction(data, data.points[0]),
    "Figure 4.16": lambda data: prediction(data, data.points[1]),
    "Figure 4.17": step_responses,
}
"""What draws each figure, in their order; that of 4.4 stands for 4.4 to 4.7."""


def _curve(
    axes: list[Any], hertz: FloatArray, response: ComplexArray, sd: FloatArray, colour: str, label: str
) -> None:
    size = np.abs(response)
    axes[0].semilogy(hertz, size, color=colour, linewidth=1.0, label=label)
    axes[0].fill_between(
        hertz,
        np.maximum(size - 1.96 * sd, 1e-2 * size),
        size + 1.96 * sd,
        color=colour,
        alpha=0.2,
        linewidth=0.0,
    )
    axes[1].plot(hertz, np.degrees(np.angle(response)), color=colour, linewidth=0.8)


def _aligned(data: ThesisData, k: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times from the start of the sequence, measured and simulated displacement at a point."""
    sim, at = data.simulated, data.points[k]
    output = data.experiments["E1"].record.output(at.point.name)
    times = output.times_s - sim.offset_s - data.modal["E1"].model.latency
    inside = (times >= 0.0) & (times <= sim.times_s[-1]) & np.isfinite(output.values)
    simulated = np.interp(times[inside], sim.times_s, sim.displacements[:, k])
    measured = output.values[inside]
    return times[inside], measured - np.mean(measured - simulated), simulated


def _theory(rig: Rig, height: float, hertz: FloatArray) -> ComplexArray:
    response = rig.beam_model().frequency_response(2.0 * math.pi * hertz, [height], drive="motion")
    return np.asarray(response.values[:, 0], dtype=np.complex128)


def _grid(data: ThesisData, low: float, high: float) -> FloatArray:
    """Return frequencies [Hz] that are dense around the poles of theory."""
    model = data.rigs["E1"].beam_model()
    hertz = model.natural_frequencies / (2.0 * math.pi)
    widths = np.maximum(hertz * model.damping_ratios, 1e-4 * hertz)
    near = [f + w * np.sinh(np.linspace(-5.0, 5.0, 161)) for f, w in zip(hertz, widths, strict=True)]
    grid = np.unique(np.concatenate([np.geomspace(low, high, _BAND_POINTS), *near]))
    return np.asarray(grid[(grid >= low) & (grid <= high)], dtype=np.float64)


def _highest(data: ThesisData) -> float:
    return float(data.rigs["E1"].excitation.end_frequency)


def _spectrum(times: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return frequencies [Hz] and amplitudes under a Hann window, for drawing."""
    step = float(np.median(np.diff(times)))
    even = np.arange(times[0], times[-1], step)
    sampled = np.interp(even, times, values)
    window = np.hanning(len(even))
    size = 2.0 * np.abs(np.fft.rfft((sampled - np.mean(sampled)) * window)) / np.sum(window)
    hertz = np.asarray(np.fft.rfftfreq(len(even), step)[1:], dtype=np.float64)
    return hertz, np.asarray(np.maximum(size[1:], 1e-12), dtype=np.float64)
