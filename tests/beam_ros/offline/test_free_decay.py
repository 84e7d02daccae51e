"""A free decay in a file, by its path: the modes that are in it, and what it cannot give."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from beam_ros.cli.main import main

MODES = ((4.4, 0.005, 0.020), (28.0, 0.004, 0.002))
"""Frequency [Hz], damping ratio and amplitude [m] of what rings."""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(11)
    t = 0.005 * np.arange(2000)
    ringing = 2e-5 * rng.standard_normal(len(t))
    for hertz, zeta, size in MODES:
        omega = 2.0 * np.pi * hertz
        ringing += size * np.exp(-zeta * omega * t) * np.cos(omega * np.sqrt(1.0 - zeta**2) * t + 0.4)
    path = tmp_path_factory.mktemp("decays") / "decay.csv"
    np.savetxt(
        path, np.column_stack([1e3 * t, 1e3 * ringing]), delimiter=",", header="t_ms,tip_mm", comments=""
    )
    return path


def test_a_decay_without_an_input_gives_its_modes_in_one_line(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["identify", str(file), "--input", "none", "--output", "tip", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found["modes"]) == len(MODES)
    for mode, (hertz, zeta, size) in zip(found["modes"], MODES, strict=True):
        # Four standard deviations: one in some 4000 of four values lies beyond.
        assert mode["frequency_hz"] == pytest.approx(hertz, abs=4.0 * mode["frequency_sd_hz"])
        assert mode["damping_ratio"] == pytest.approx(zeta, abs=4.0 * mode["damping_ratio_sd"])
        assert mode["frequency_sd_hz"] < 1e-3
        assert mode["amplitudes"]["tip"] == pytest.approx(size, rel=0.01)


def test_a_part_of_a_decay_is_taken_and_people_read_a_table(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [
        "identify",
        str(file),
        "--input",
        "none",
        "--output",
        "tip",
        "--from",
        "2",
        "--to",
        "8",
        "--modes",
        "1",
    ]
    assert main(given) == 0
    said = capsys.readouterr().out
    assert "free decay" in said
    assert " 4.40" in said


@pytest.mark.parametrize(
    ("verb", "more", "said"),
    [
        ("identify", ["--output", "tip"], "--input none` needs no input"),
        ("identify", ["--input", "none"], "no output is named.*t_ms, tip_mm"),
        ("identify", ["--input", "none", "--output", "tip", "--axis"], "leave --axis out"),
        ("identify", ["--input", "none", "--output", "tip", "--report", "r"], "leave --report out"),
        ("check", ["--input", "none", "--output", "tip"], "expected an input here"),
    ],
)
def test_what_a_decay_cannot_give_is_refused_with_the_remedy(
    file: Path, capsys: pytest.CaptureFixture[str], verb: str, more: list[str], said: str
) -> None:
    assert main([verb, str(file), *more]) == 2
    line = capsys.readouterr().err
    assert "Traceback" not in line
    assert re.search(said, line)


def test_a_bag_has_its_hub_for_an_input(capsys: pytest.CaptureFixture[str]) -> None:
    bag = Path(__file__).resolve().parents[3] / "bags" / "step"
    assert main(["identify", str(bag), "--input", "none"]) == 2
    assert "expected one file of columns" in capsys.readouterr().err


def test_an_axis_is_not_identified_from_a_file(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", str(file), "--input", "t_ms", "--output", "tip", "--axis"]) == 2
    assert "leave --axis out, or give force and position to `identify_axis`" in capsys.readouterr().err
