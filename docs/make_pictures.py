"""Make the pictures of the README and of the pages: the rig, a frame, an identification, a chart, clocks.

    .venv/bin/python docs/make_pictures.py [FOLDER]          # default: docs/pictures

Everything in them is computed: the beam's shape and its frames by the model of the default rig, the identification
from the recorded bag of this tree, the chart from the code of its page. Pictures of a page in a browser are made
where Playwright and a Chromium are installed (the extra `browser`).
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import runpy
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle
from PIL import Image

from beam_ident import LogChirp, analyse_modes, identify
from beam_ident.figures import (
    amplitude_figure,
    best_linear_figure,
    excitation_figure,
    fit_figure,
    frequency_response_figure,
    mode_shape_figure,
    response_over_model_figure,
    stabilisation_figure,
    time_figure,
)
from beam_ident.figures.response_curves import drawing_lines, response_curves
from beam_ident.responses.local_polynomial import local_polynomial_response
from beam_ros.bags.reading import Bag
from beam_ros.bags.summary import summarise
from beam_ros.checks.bag_check import gates_of_bag
from beam_ros.errors import UsageError
from beam_ros.excitation.shaping import MoveOrder, shape_for_rig, unshaped_beside
from beam_ros.experiments.quiet_moves import swings_figure
from beam_ros.messages import BagTypes
from beam_ros.offline.axis_following import following_of_bag
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.recorded_estimates import estimates_of_bag
from beam_ros.offline.simulation import simulate
from beam_ros.offline.swing_after import swing_after
from beam_ros.offline.theory import theory_of_rig
from beam_ros.offline.whole_beam import strip_parameters
from beam_ros.reporting.move_figures import insensitivity_figure
from beam_ros.reporting.printing import find_browser
from beam_ros.rig.rig import Rig
from beam_ros.studies.rows import Item, Settings, find_bags, study_row
from beam_ros.studies.summary import deviation_figure
from beam_ros.thesis.data import estimate_all
from beam_ros.thesis.figures import bode
from beam_ros.view.losses import losses_of_bag
from beam_ros.view.recorded import RecordedScene
from beam_ros.view.scene import Scene
from beam_ros.view.server import PageServer
from beam_ros.viewers.curves import COLOURS, live_plots
from beam_ros.vision.measurement.overlay import draw_overlay
from beam_ros.vision.rendering.frames import SceneRenderer
from beam_ros.vision.strip.moving_line import StripFollower
from beam_ros.vision.timing import FrameTiming
from beam_ros.vision.tracking.tracker import MarkerTracker

ROOT = Path(__file__).resolve().parents[1]
INK, STEEL, MARKER, FAINT = "#1f2937", "#475569", "#c2410c", "#94a3b8"
_COLOURS = 128
HUB_M = 0.012
TIP_M = (0.020, 0.004)
"""Position of the hub, and what the first two modes do to the tip [m], in the drawn instant."""


def displacement(rig: Rig, heights: np.ndarray) -> np.ndarray:
    """Return u of the drawn instant [m] at heights [m], both of shape (n_heights,)."""
    model = rig.beam_model()
    tip = model.shape([rig.beam.length])[0, :2]
    return HUB_M + model.shape(heights)[:, :2] @ (np.array(TIP_M) / tip)


def rig_picture(rig: Rig) -> Figure:
    """Draw the rig as the camera sees it, with the names of what is measured, beside a tracked frame."""
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    sketch, frame = figure.subplots(1, 2, width_ratios=(1.0, 1.0))
    length, markers = rig.beam.length, np.array(rig.markers.heights)
    z = np.linspace(0.0, length, 200)
    u = displacement(rig, z)
    sketch.plot(1e3 * u, 1e3 * z, color=STEEL, linewidth=2.5)
    sketch.plot([0.0, 0.0], [0.0, 1e3 * length], color=FAINT, linewidth=1.0, linestyle=(0, (4, 4)))
    sketch.plot(1e3 * displacement(rig, markers), 1e3 * markers, "o", color=MARKER, markersize=8)
    for name, height in zip(rig.markers.names, markers, strict=True):
        at = 1e3 * displacement(rig, np.array([height]))[0]
        sketch.annotate(name, (at, 1e3 * height), xytext=(10, -3), textcoords="offset points", color=MARKER)
    half = 500.0 * rig.hub.travel
    sketch.add_patch(Rectangle((1e3 * HUB_M - 14, -22), 28, 20, facecolor="#e2e8f0", edgecolor=INK))
    sketch.text(1e3 * HUB_M, -12, "hub", ha="center", va="center", color=INK)
    sketch.plot([-half, half], [-24, -24], color=INK, linewidth=2.0)
    arrow(sketch, (0.0, -34), (1e3 * HUB_M, -34))
    sketch.text(0.5e3 * HUB_M, -46, "α(t)", ha="center", color=INK)
    top = 1e3 * float(displacement(rig, np.array([length]))[0])
    arrow(sketch, (1e3 * HUB_M, 1e3 * length + 8), (top, 1e3 * length + 8))
    sketch.text(0.5 * (top + 1e3 * HUB_M), 1e3 * length + 13, "w(L, t)", ha="center", color=INK)
    arrow(sketch, (-half, 0.0), (-half, 60.0))
    sketch.text(-half - 5, 62, "z", color=INK)
    sketch.text(half + 2, -27, "x", color=INK)
    sketch.text(
        1e3 * HUB_M + 14,
        0.4e3 * length,
        f"steel strip\n{1e3 * length:.0f} x {1e3 * rig.beam.width:.0f} x {1e3 * rig.beam.thickness:.1f} mm",
        color=STEEL,
    )
    sketch.set(xlim=(-half - 20, half + 45), ylim=(-52, 1e3 * length + 26), aspect="equal")
    sketch.set_title("u(z, t) = α(t) + w(z, t)", fontsize=11, color=INK)
    sketch.axis("off")
    frame.imshow(tracked_frame(rig), interpolation="nearest")
    frame.set_title("a frame, and what the tracker measures in it", fontsize=11, color=INK)
    frame.axis("off")
    return figure


def arrow(axes: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Draw an arrow between two points of the data."""
    axes.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=12, color=INK))


def tracked_frame(rig: Rig) -> np.ndarray:
    """Render the drawn instant, track it, and return the middle of its overlay, red, green, blue."""
    camera = rig.camera_parameters()
    heights = np.array(rig.markers.heights)
    strip = np.linspace(0.0, rig.beam.length, 60)
    renderer = SceneRenderer(camera, heights, strip_heights=strip)
    rng = np.random.default_rng(1)
    image = renderer.render(displacement(rig, heights), rng, displacement(rig, strip))
    tracker = MarkerTracker(rig.tracker_parameters(), len(heights), FrameTiming(camera))
    found = tracker.process(image, 0)
    drawn = draw_overlay(image, found, rig.markers.names, marker_diameter_px=camera.marker_diameter_px)
    left = round(camera.origin_px[0]) - 60
    return drawn[:, left : left + 270, ::-1]


def identification_pictures() -> dict[str, Figure]:
    """Identify the recorded bag and draw its responses and its fit."""
    recorded = load_experiment(ROOT / "bags" / "chirp_6s")
    result = identify(recorded.record, recorded.structure, clock_rate=recorded.clock_rate)
    lines = drawing_lines((result.model,), 1.0, 350.0)
    curves = response_curves(result.model, lines)
    measured = local_polynomial_response(recorded.record)
    theory = theory_of_rig(recorded.rig, recorded.structure, recorded.apparatus.is_simulated)
    heights = np.array([theory.places[name] for name in result.model.output_names])
    shapes = mode_shape_figure(
        [f"mode {k + 1}" for k in range(result.model.n_modes)],
        theory.heights,
        theory.shapes,
        heights[:, 0],
        heights[:, 1],
        result.model.residues,
        result.model.residue_sd,
    )
    return {
        "frequency-response": frequency_response_figure(curves),
        "fit": fit_figure(result.outputs),
        "measured-response": response_over_model_figure([measured], result.model),
        "mode-shapes": shapes,
    }


def tutorial_pictures() -> dict[str, Figure]:
    """Draw what the first tutorial draws, from its code."""
    names = names_of_page("tutorials/first-identification.md", 5)
    return {
        "tutorial-record": time_figure(names["record"]),
        "tutorial-fit": fit_figure(names["result"].outputs),
    }


def excitation_picture(rig: Rig) -> Figure:
    """Draw the default chirp: its levels over time, its density over frequency, and the modes in it."""
    recorded = load_experiment(ROOT / "bags" / "chirp_6s")
    model = identify(recorded.record, recorded.structure, clock_rate=recorded.clock_rate).model
    chirp = LogChirp(
        start_frequency=1.0, end_frequency=95.0, duration=20.0, acceleration=0.7, max_displacement=0.005
    )
    return excitation_figure(chirp.sample(rig.hub.period), model)


def frame_picture(rig: Rig) -> Figure:
    """Draw a frame, and one marker of it as close as its pixels are, with its centre and its uncertainty."""
    camera, heights = rig.camera_parameters(), np.array(rig.markers.heights)
    strip = np.linspace(0.0, rig.beam.length, 60)
    renderer = SceneRenderer(camera, heights, strip_heights=strip)
    image = renderer.render(displacement(rig, heights), np.random.default_rng(1), displacement(rig, strip))
    found = MarkerTracker(rig.tracker_parameters(), len(heights), FrameTiming(camera)).process(image, 0)
    tip = found.markers[-1]
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    whole, close = figure.subplots(1, 2)
    whole.imshow(image, cmap="gray", vmin=0, vmax=255)
    whole.plot(
        [m.u_px for m in found.markers], [m.v_px for m in found.markers], "+", color=MARKER, markersize=14
    )
    whole.set(xlabel="u [px]", ylabel="v [px]", title="a frame, and the markers found in it")
    close.imshow(image, cmap="gray", vmin=0, vmax=255)
    close.plot(tip.u_px, tip.v_px, "+", color=MARKER, markersize=28, markeredgewidth=2)
    close.set(xlim=(tip.u_px - 11, tip.u_px + 11), ylim=(tip.v_px + 11, tip.v_px - 11), xlabel="u [px]")
    close.set_title(f"one of them: u = {tip.u_px:.3f} +- {tip.sigma_px:.3f} px", fontsize=11)
    return figure


def transfer_function_picture() -> Figure:
    """Draw poles and response of the motor with a flexible shaft, from the page's code."""
    names = names_of_page("transfer-functions.md", 1)
    found, truth = names["found"].model, names["plant"]
    figure = Figure(figsize=(8.0, 3.8), layout="constrained")
    response, output = figure.subplots(1, 2)
    omegas = 2 * np.pi * np.geomspace(0.1, 10.0, 300)
    for model, colour, label in ((truth, FAINT, "truth"), (found, MARKER, "identified")):
        size = np.abs(model.frequency_response(omegas)[0]).ravel()
        style = "-" if model is truth else "--"
        response.loglog(omegas / (2 * np.pi), size, style, color=colour, linewidth=2.0, label=label)
    response.set(xlabel="frequency [Hz]", ylabel="|angle / volt| [rad/V]", title="response")
    response.legend()
    result = names["found"]
    few = np.argsort(result.times_s)[:400]
    output.plot(result.times_s[few], result.measured[few], ".", color=STEEL, markersize=3, label="measured")
    output.plot(result.times_s[few], result.modelled[few], color=MARKER, linewidth=1.2, label="model")
    output.set(xlabel="time [s]", ylabel="angle [rad]", title="samples at irregular stamps")
    output.legend()
    return figure


def axis_picture() -> Figure:
    """Draw the friction of the page's axis over its speed, as identified and as written down."""
    axis = names_of_page("axis.md", 1)["axis"]
    speed = np.linspace(-2.0, 2.0, 401)
    columns = np.column_stack([speed, np.sign(speed), np.ones_like(speed)])
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(speed, columns @ [4.0, 1.5, 0.0], color=FAINT, linewidth=5, label="written down")
    axes.plot(speed, columns @ axis.estimates[1:4], color=MARKER, label="identified from force and position")
    axes.set(xlabel="speed [m/s]", ylabel="friction [N]", title="what holds the axis back")
    axes.legend()
    return figure


def simulation_picture() -> Figure:
    """Draw where the hub is against its command, in the ideal and in the realistic rig."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    short = {"excitation.duration": 3.0, "excitation.still": 1.0, "hub.command_mode": "position"}
    for row, preset in zip(axes, ("ideal", "realistic"), strict=True):
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / preset
            simulate(Rig.from_file().with_values({**short, "simulation.preset": preset}), bag)
            with Bag(bag) as opened:
                led, seen = opened.hub_samples("hub/applied"), opened.hub_samples("hub/measured")
        n = min(len(led.positions), len(seen.positions))
        times = 1e-9 * (seen.stamps_ns[:n] - seen.stamps_ns[0])
        row.plot(times, 1e6 * (seen.positions[:n] - led.positions[:n]), color=MARKER, linewidth=0.8)
        row.set(ylabel="measured less\ncommanded [um]", title=preset)
    axes[1].set_xlabel("time [s]")
    return figure


def links_picture() -> Figure:
    """Draw what stands between this suite and a motor, and who keeps which promise."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    axes = figure.subplots()
    rows = (
        ("beam", "a board with this suite's firmware", "limits and stop: the board"),
        (
            "trajectory_controller",
            "controller_manager of ros2_control",
            "sequences run on when the host dies",
        ),
        ("odrive", "ODrive 3.x", "stop: its watchdog; the motor coasts"),
        ("dynamixel", "Dynamixel X series", "stop: its watchdog; the motor holds"),
        ("csv", "a board that prints lines", "takes no commands"),
    )
    axes.add_patch(Rectangle((0.0, 0.0), 1.6, 5.0, facecolor="#e2e8f0", edgecolor=INK))
    axes.text(0.8, 2.5, "the driver\n(node hub)", ha="center", va="center", color=INK)
    for k, (kind, device, promise) in enumerate(rows):
        y = 4.5 - k
        arrow(axes, (1.6, y), (4.4, y))
        axes.text(3.0, y + 0.12, kind, ha="center", color=STEEL, fontsize=9)
        axes.add_patch(Rectangle((4.4, y - 0.35), 4.0, 0.7, facecolor="white", edgecolor=INK))
        axes.text(6.4, y, device, ha="center", va="center", color=INK, fontsize=9)
        axes.text(8.6, y, promise, va="center", color=MARKER, fontsize=9)
    axes.set(xlim=(-0.1, 13.0), ylim=(-0.1, 5.1))
    axes.axis("off")
    return figure


def names_of_page(page: str, blocks: int) -> dict[str, Any]:
    """Run the first blocks of code of a page, and return what they define."""
    names: dict[str, Any] = {"print": lambda *_words: None}
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    before = Path.cwd()
    os.chdir(ROOT)  # from where the pages name files
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)[:blocks]:
        exec(compile(block, page, "exec"), names)
    os.chdir(before)
    return names


def stabilisation_picture() -> Figure:
    """Draw the chart of the page on modal analysis, from the page's own code."""
    chart = names_of_page("modal-analysis.md", 2)["chart"]
    return stabilisation_figure(chart, analyse_modes(chart))


def clocks_picture(rig: Rig) -> Figure:
    """Draw what three ways with clocks leave of the tip's displacement, and by how much mode 1 is off."""
    names = names_of_page("clocks.md", 1)
    truth = float(rig.beam_model().natural_frequencies[0])
    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    grid = figure.add_gridspec(3, 2, width_ratios=(2.2, 1.0))
    poles = figure.add_subplot(grid[:, 1])
    for row, (way, unit, per_metre) in enumerate(
        (("counted", "mm", 1e3), ("stamped", "um", 1e6), ("mapped", "um", 1e6))
    ):
        result = names[way]
        tip = result.outputs[-1]
        axes = figure.add_subplot(grid[row, 0])
        axes.plot(tip.times_s - tip.times_s[0], per_metre * tip.residuals, ".", color=STEEL, markersize=2.5)
        axes.set_ylabel(f"{way} [{unit}]")
        axes.tick_params(labelbottom=row == 2)
        omegas, _, omega_sd, _ = result.model.modes()
        error, sd = 1e6 * (omegas[0] / truth - 1.0), 1e6 * omega_sd[0] / truth
        if abs(error) < 1000.0:
            poles.errorbar([row], [error], yerr=1.96 * sd, fmt="o", color=MARKER, capsize=5)
        else:
            poles.annotate(
                f"{1e-4 * error:.1f} %",
                (row, 0.0),
                xytext=(row, -40.0),
                ha="center",
                color=MARKER,
                arrowprops={"arrowstyle": "<-", "color": MARKER},
            )
    figure.axes[1].set_title("what the fit leaves of the tip's displacement", fontsize=11, color=INK)
    axes.set_xlabel("time [s]")
    poles.axhline(0.0, color=FAINT, linewidth=1.0)
    poles.set(xlim=(-0.6, 2.6), ylim=(-100.0, 100.0), ylabel="error of the first natural frequency [ppm]")
    poles.set_xticks(range(3), ["counted", "stamped", "mapped"])
    poles.set_title("with 95 % intervals", fontsize=11, color=INK)
    return figure


def viewers_picture() -> Figure:
    """Draw what the layouts of the viewers show of the recording with frames."""
    with Bag(ROOT / "bags" / "frames") as bag:
        rig = Rig.from_nested((bag.excitation_info() or {})["rig"])
        hub, seen = bag.hub_samples("hub/measured"), bag.displacements()
        raw = next(message for k, message in enumerate(bag.raw_messages("camera/image_raw")) if k == 150)
    image = BagTypes().deserialize(raw.data, "sensor_msgs/msg/Image")
    frame = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width)
    camera = rig.camera_parameters()
    found = MarkerTracker(rig.tracker_parameters(), len(rig.markers.names), FrameTiming(camera)).process(
        frame, 0
    )
    drawn = draw_overlay(frame, found, [""] * 3, marker_diameter_px=camera.marker_diameter_px)
    values = {
        "beam/displacement.position": (seen.stamps_ns, seen.positions),
        "hub/state.position": (hub.stamps_ns, hub.positions[:, None]),
        "hub/state.velocity": (hub.stamps_ns, hub.velocities[:, None]),
    }
    plots = [p for p in live_plots(rig.markers.names) if f"{p.curves[0].topic}.{p.curves[0].field}" in values]
    figure = Figure(figsize=(9.0, 5.2), layout="constrained")
    grid = figure.add_gridspec(len(plots), 2, width_ratios=(3.2, 1.0))
    for row, plot in enumerate(plots):
        axes = figure.add_subplot(grid[row, 0])
        for curve, colour in zip(plot.curves, COLOURS, strict=False):
            stamps_ns, columns = values[f"{curve.topic}.{curve.field}"]
            times = 1e-9 * (stamps_ns - hub.stamps_ns[0])
            axes.plot(times, columns[:, curve.index], color=colour, linewidth=0.9, label=curve.joint)
        axes.set_title(plot.title, fontsize=10, color=INK)
        axes.tick_params(labelbottom=row == len(plots) - 1)
        if len(plot.curves) > 1:
            axes.legend(loc="upper right", fontsize=8)
    axes.set_xlabel("time [s]")
    picture = figure.add_subplot(grid[:, 1])
    picture.imshow(drawn[:, :, ::-1], interpolation="nearest")
    picture.set_title("what the tracker sees", fontsize=10, color=INK)
    picture.axis("off")
    return figure


def study_picture() -> Figure:
    """Draw the first natural frequency in the recordings of a hub that is moved, as the page of a study does."""
    settings = Settings(Rig.from_file().identifier)
    bags = [bag for bag in find_bags([str(ROOT / "bags")]) if bag.name != "hammer"]
    rows = [study_row(Item(bag=bag), settings, gates_of_bag) for bag in bags]
    figure = deviation_figure(rows, mode=1)
    figure.axes[0].set_xticks(range(1, len(bags) + 1), [bag.name for bag in bags], fontsize=8)
    figure.axes[0].set_xlabel("")
    return figure


def amplitude_picture() -> Figure:
    """Draw frequency and damping of a strip in air over its amplitude, as the page's commands make them."""
    changes = {
        "excitation.kind": "doublet",
        "excitation.acceleration": 1.5,
        "excitation.step_size": 0.002,
        "excitation.width": 0.1,
        "excitation.gap": 0.1,
        "excitation.still": 20.0,
        "simulation.drag_coefficient": 6.0,
        "simulation.large_deflections": True,
    }
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "drag"
        simulate(Rig.from_file().with_values(changes), bag)
        found = identification_of_bags(bag, options=FitOptions(n_modes=1, amplitude=True))
    assert found.curves is not None
    first = found.content["modes"][0]
    return amplitude_figure(found.curves, (first["frequency_hz"], first["damping_ratio"]))


def best_linear_picture() -> Figure:
    """Draw response, noise and distortion of the example: an actuator that saturates before a beam."""
    with contextlib.redirect_stdout(io.StringIO()):
        names = runpy.run_path(str(ROOT / "examples" / "best_linear.py"))
    return best_linear_figure(names["best"])


def whole_beam_picture(rig: Rig) -> Figure:
    """A frame of the strip without dots, what was found in it, and how far that is off."""
    camera = replace(rig.camera_parameters(), width=200, origin_px=(60.0, 465.0), strip_contrast=120.0)
    heights = np.linspace(0.0, rig.beam.length, 151)
    renderer = SceneRenderer(camera, [0.01], strip_heights=heights)
    rng = np.random.default_rng(2)
    parameters = strip_parameters(camera, rig.beam.length, 10)
    follower = StripFollower(parameters, (camera.height, camera.width))
    light = renderer.light([np.nan], displacement(rig, heights))
    noise = camera.noise_grey * rng.standard_normal((5, *light.shape))
    frames = np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)
    for frame in frames:
        found = follower.process(frame)
    above = (camera.origin_px[1] - follower.rows_px) / camera.pixels_per_metre
    error = found.u_px - camera.columns(displacement(rig, above))
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    seen, off = figure.subplots(1, 2, width_ratios=(1, 1.6), sharey=True)
    seen.imshow(frames[-1], cmap="gray", vmin=0, vmax=120, aspect="auto")
    seen.plot(found.u_px, follower.rows_px, ".", color=MARKER, markersize=3)
    seen.set(xlabel="column [px]", ylabel="row [px]", title="one frame, 45 points")
    off.errorbar(
        error, follower.rows_px, xerr=found.sigma_px, fmt=".", color=STEEL, markersize=4, linewidth=1
    )
    off.axvline(0.0, color=FAINT, linewidth=1)
    off.set(xlabel="error [px], with the stated standard deviation", title="against the truth")
    return figure


def thesis_picture() -> Figure:
    """Draw figure 4.14 of `beam thesis`, from the short recordings of this tree."""
    kept = {"E1": "chirp_6s", "E2": "multisine", "V2": "multisine", "S": "step"}
    bags = {name: ROOT / "bags" / bag for name, bag in kept.items()}
    data = estimate_all(bags, None, lambda phrase, share: None)
    return bode(data, data.points[1])


def quiet_move_pictures() -> dict[str, Figure]:
    """Draw what the page on quiet moves shows: what moves leave over the error of frequency, and both swings."""
    rig = Rig.from_file().with_values({"simulation.images": False})
    order = MoveOrder(0.0, 0.05, 20e-6)
    with tempfile.TemporaryDirectory() as folder:
        bags = {name: Path(folder) / name for name in ("first", "unshaped", "shaped")}
        simulate(rig, bags["first"])
        model = identification_of_bags(bags["first"], options=FitOptions(n_modes=3)).result.model
        found = shape_for_rig(rig, order, model, axis=following_of_bag(bags["first"]))
        rigs = {"unshaped": unshaped_beside(found), "shaped": found.rig}
        for name, own in rigs.items():
            simulate(own.with_values({"excitation.still": 0.1}), bags[name])
        seen = {name: swing_after(bags[name], model) for name in rigs}
    low, high = found.choice.chosen.residual.interval
    worst = found.choice.chosen.residual.worst
    swings = {name: (own.times_s, own.deflections[:, worst]) for name, own in seen.items()}
    return {
        "quiet-move": swings_figure(swings, (low[worst], high[worst]), order.aim),
        "insensitivity": insensitivity_figure(found.choice),
    }


PAGE_PICTURES = {
    "view-light": {"color_scheme": "light", "viewport": {"width": 1280, "height": 900}},
    "view-dark": {"color_scheme": "dark", "viewport": {"width": 1280, "height": 900}},
    "view-phone": {"color_scheme": "light", "viewport": {"width": 360, "height": 740}},
}
"""Pictures that a browser takes of the page of `beam view`, and how it holds it."""


def page_pictures(folder: Path) -> list[Path]:
    """Write the pictures of the page over a bag; returns none where there is no browser."""
    try:
        from playwright.sync_api import sync_playwright

        executable = find_browser()
    except (ImportError, UsageError):
        return []
    bag = ROOT / "bags" / "frames"
    scene = Scene(Rig.from_file(), source="bag", title="bags/frames")
    with Bag(bag) as opened:
        scene.show_losses(losses_of_bag(summarise(opened)))
    estimates = list(estimates_of_bag(bag, Rig.from_file().live))
    player = RecordedScene(bag, scene, estimate_at=lambda _: estimates[-2][1])
    links: list[str] = []
    server = PageServer(scene, player.orders, on_tick=player.show, on_link=links.append)
    files = []
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        player.start(is_paused=True)
        player.orders["seek"](4.3)
        for name, options in PAGE_PICTURES.items():
            page = browser.new_page(**options)
            page.goto(links[0])
            page.wait_for_selector("#camera:not([hidden])")
            page.wait_for_timeout(1000.0)  # The notes are written four times a second.
            files.append(folder / f"{name}.png")
            page.screenshot(path=files[-1], full_page=name != "view-phone")
        browser.close()
    server.close()
    player.close()
    return files


def make_pictures(folder: Path) -> list[Path]:
    """Write every picture into a folder and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        "rig": rig_picture(Rig.from_file()),
        "frame": frame_picture(Rig.from_file()),
        "excitation": excitation_picture(Rig.from_file()),
        "transfer-function": transfer_function_picture(),
        "axis": axis_picture(),
        "simulation": simulation_picture(),
        "links": links_picture(),
        **tutorial_pictures(),
        **identification_pictures(),
        "stabilisation": stabilisation_picture(),
        "clocks": clocks_picture(Rig.from_file()),
        "viewers": viewers_picture(),
        "study": study_picture(),
        "amplitude": amplitude_picture(),
        "best-linear": best_linear_picture(),
        "whole-beam": whole_beam_picture(Rig.from_file()),
        "thesis": thesis_picture(),
        **quiet_move_pictures(),
    }
    files = page_pictures(folder)
    for name, figure in figures.items():
        files.append(folder / f"{name}.png")
        figure.savefig(files[-1], dpi=110)
    for path in files:
        with Image.open(path) as drawn:
            small = drawn.convert("RGB").quantize(_COLOURS)
        small.save(path, optimize=True)
    return files


if __name__ == "__main__":
    for made in make_pictures(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pictures"):
        print(f"{made}   {made.stat().st_size / 1000:.0f} kB")
