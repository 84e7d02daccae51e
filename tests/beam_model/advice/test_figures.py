from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from beam_model import BeamModel, Damping
from beam_model.advice import figures
from tests.beam_model.rigs import HEIGHTS, strip

pytest.importorskip("matplotlib", reason="figures need Matplotlib")
MODEL = BeamModel(strip(gravity="upright", damping=Damping(ratios=(0.005,))), 4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["modes", "bode", "bode_force", "poles"])
def test_figures_are_drawn_to_a_file(name: str, tmp_path: Path) -> None:
    figure = {
        "modes": lambda: figures.mode_shape_figure(MODEL, HEIGHTS),
        "bode": lambda: figures.bode_figure(MODEL, HEIGHTS),
        "bode_force": lambda: figures.bode_figure(MODEL, [0.1], [1.0, 10.0, 100.0], drive="force"),
        "poles": lambda: figures.pole_figure(MODEL),
    }[name]()
    path = tmp_path / f"{name}.png"
    figure.savefig(path)
    assert path.stat().st_size > 10_000


def test_a_mode_shape_figure_shows_every_mode_and_node() -> None:
    figure = figures.mode_shape_figure(MODEL, HEIGHTS, n_modes=3)
    assert [axis.get_title().split("\n")[0] for axis in figure.axes] == ["mode 1", "mode 2", "mode 3"]
    dots = [line for line in figure.axes[2].lines if line.get_marker() == "o"]
    assert len(dots[0].get_xdata()) == 2


def test_every_pole_lies_inside_the_pole_figure() -> None:
    for model in (MODEL, BeamModel(strip(), 3)):
        axis = figures.pole_figure(model).axes[0]
        left, right = axis.get_xlim()
        assert left == 0.0
        for line in axis.lines:
            # Undamped poles of the free hub lie within rounding of the axis.
            assert all(left - 1e-9 <= value < right for value in line.get_xdata())


@pytest.mark.slow
def test_importing_the_model_brings_no_drawing_library() -> None:
    code = "import sys, beam_model.advice.figures; sys.exit(bool({'matplotlib', 'rclpy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
