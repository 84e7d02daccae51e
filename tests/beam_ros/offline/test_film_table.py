"""A film without a bag becomes a table, and a picture of what was seen: `beam track --csv`, `--explain`."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from beam_ros.cli.main import main

cv2 = pytest.importorskip("cv2")

HERE = Path(__file__).parents[3] / "bags" / "video_96x240"
FILM, RIG_FILE = str(HERE / "video.avi"), str(HERE / "rig.yaml")


@pytest.fixture
def short(tmp_path: Path) -> str:
    """The film's first frames."""
    source, path = cv2.VideoCapture(FILM), tmp_path / "short.avi"
    sink = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), 100.0, (96, 240), False)
    for _ in range(30):
        sink.write(cv2.cvtColor(source.read()[1], cv2.COLOR_BGR2GRAY))
    sink.release()
    return str(path)


def test_a_film_alone_becomes_a_table_by_its_own_time(
    short: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, picture = tmp_path / "points.csv", tmp_path / "frame.png"
    words = ["track", short, "--rig-file", RIG_FILE, "--csv", str(table), "--explain", str(picture), "--json"]
    assert main(words) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["markers"]["z285"]["seen"] == result["frames"] == 30
    rows = list(csv.DictReader(table.open(encoding="utf-8")))
    times = [float(row["z010_time_s"]) for row in rows]
    assert times == pytest.approx(np.arange(30) / 100.0)

    u, x = (np.array([float(row[f"z285_{what}"]) for row in rows]) for what in ("u_px", "x_m"))
    slope = np.polyfit(x, u, 1)[0]
    assert slope == pytest.approx(750.0, rel=1e-3)
    assert all(0.0 < float(row["z285_sd_m"]) < 1e-3 for row in rows)
    assert cv2.imread(str(picture)).shape == (240, 96, 3)
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_film_that_is_refused_is_explained(
    short: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, picture = tmp_path / "points.csv", tmp_path / "frame.png"
    words = ["track", short, "--rig-file", RIG_FILE, "-p", "markers.diameter:=0.013"]
    assert main([*words, "--csv", str(table), "--explain", str(picture)]) == 2
    assert "is in none of 30 frames" in capsys.readouterr().err
    assert not table.exists()
    drawn = cv2.imread(str(picture)).astype(int)
    # What stands out is marked in blue, the markers that are missing are named in red.
    assert np.any(drawn[..., 0] - drawn[..., 2] > 100)
    assert np.any(drawn[..., 2] - drawn[..., 0] > 100)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--csv", "{}/a.csv", "--explain", "{}/no/such/frame.png"], "cannot be written"),
        (["--csv", "{}/a.csv", "--explain", "{}/frame.what"], "cannot be written"),
        (["--csv", "{}/a.csv", "--points", "full", "--explain", "{}/frame.png"], "without --points full"),
    ],
)
def test_what_cannot_be_drawn_is_said(
    short: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    given = [word.format(tmp_path) for word in words]
    assert main(["track", short, "--rig-file", RIG_FILE, *given]) == 2
    assert said in capsys.readouterr().err
