"""Make the pictures of the README and of the pages: the rig, a frame, an identification, a stabilisation chart.

    .venv/bin/python docs/make_pictures.py [FOLDER]          # default: docs/pictures

Everything in them is computed: the beam's shape and its frames by the model of the default rig, the identification
from the recorded bag of this tree, the chart from the code of its page.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Rectangle
from PIL import Image

from beam_ident import analyse_modes, identify
from beam_ident.figures import fit_figure, frequency_response_figure, stabilisation_figure
from beam_ros.offline.identification import load_experiment
from beam_ros.rig.rig import Rig
from beam_ros.vision.measurement.overlay import draw_overlay
from beam_ros.vision.rendering.frames import SceneRenderer
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
    return {"frequency-response": frequency_response_figure(result), "fit": fit_figure(result)}


def stabilisation_picture() -> Figure:
    """Draw the chart of the page on modal analysis, from the page's own code."""
    page = (ROOT / "docs" / "modal-analysis.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {"print": lambda *_words: None}
    for block in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)[:2]:
        exec(compile(block, "docs/modal-analysis.md", "exec"), names)
    return stabilisation_figure(names["chart"], analyse_modes(names["chart"]))


def make_pictures(folder: Path) -> list[Path]:
    """Write every picture into a folder and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {
        "rig": rig_picture(Rig.from_file()),
        **identification_pictures(),
        "stabilisation": stabilisation_picture(),
    }
    files = []
    for name, figure in figures.items():
        files.append(folder / f"{name}.png")
        figure.savefig(files[-1], dpi=110)
        with Image.open(files[-1]) as drawn:
            small = drawn.convert("RGB").quantize(_COLOURS)
        small.save(files[-1], optimize=True)
    return files


if __name__ == "__main__":
    for made in make_pictures(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "pictures"):
        print(f"{made}   {made.stat().st_size / 1000:.0f} kB")
