"""The examples, each as its own process, as a reader would start them."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
ROBOT_ARM = os.environ.get("ROBOT_ARM_DATA", "")
PAGE = Path(__file__).resolve().parents[1] / "docs" / "robot-arm.md"

# Regular expressions, as last digits depend on LAPACK's rounding.
SAYS = {
    "amplitude.py": [
        "one pole does not describe the decay",
        "one pole describes the decay",
        "refused: output 'tip' of decay 0 has 40 samples",
    ],
    "data.py": [
        "186 of 189 frames seen",
        r"two runs together: (4\.400|4\.399)\d Hz, 28\.(29|30)",
        "refused: signal 'hub'",
    ],
    "excitation.py": [
        "crest factor",
        r"tip: predicted to reach 0\.019",
        "refused: PointToPoint: peak travel",
    ],
    "first_look.py": [
        r"peak of +\d+\.\d+ \+- \d+\.\d+ at 28\.(2|3)",
        r"half-power band of mode 1: 0\.070 Hz",
    ],
    "estimation.py": [
        "2 modes",
        r"  (4\.400|4\.399)\d",
        r"  28\.(29|30)",
        r"transfer function: (4\.400|4\.399)",
    ],
    "frequency_domain.py": [
        r"4 periods, 149 lines, drift [01]\.\d",
        "no nonlinear distortion",
        r"  (4\.400|4\.399)\d",
        r"transfer function: 28\.(29|30)",
    ],
    "best_linear.py": [
        "nonlinear: distortion of -20 dB",
        "with odd distortion",
        r"total: (4\.00|3\.99)",
    ],
    "next_experiment.py": ["D-optimal excitation", "of the chirp's standard deviation", "promised"],
    "order_selection.py": ["not worth its parameters by BIC", "chosen"],
    "results.py": ["chi-squared", "fit percentage of tip on a step"],
    "driven_axis.py": [
        r"moving mass \[kg\] +(2\.000|1\.999)",
        r"dry friction \[N\] +(3|3\.000|2\.999)",
        "no force is seen that the model lacks",
        "refused: the axis never moved backward",
    ],
    "validation.py": ["tip: good prediction", "as stated: the 4 records", "more than stated: the 4 records"],
    "modal_analysis.py": [
        "3 modes",
        r"14\.166\d",
        r"57\.357\d",
        r"MAC with the true shapes: \[1\. 1\. 1\.\]",
    ],
}


def run(name: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run an example in a process of its own."""
    return subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments],
        capture_output=True,
        text=True,
        timeout=120.0,
        env={**os.environ, "PYTHONWARNINGS": "error::DeprecationWarning:__main__", **environment},
        check=False,
    )


def test_every_example_is_run_here() -> None:
    assert {path.name for path in EXAMPLES.glob("*.py")} == {*SAYS, "robot_arm.py", "simulated_beam.py"}


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SAYS))
def test_an_example_runs_and_says_what_its_topic_is_about(name: str) -> None:
    ended = run(name)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    for words in SAYS[name]:
        assert re.search(words, ended.stdout), (words, ended.stdout)


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_an_example_is_short_and_tells_its_topic_first(path: Path) -> None:
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    assert len(lines) <= 40
    assert lines[0].startswith('"""')


@pytest.mark.slow
def test_without_its_data_the_robot_arm_says_where_they_are() -> None:
    ended = run("robot_arm.py", "nowhere.dat")
    assert ended.returncode == 1
    assert ended.stderr.count("\n") == 1
    assert "skipped, no nowhere.dat" in ended.stderr
    assert "daisy" in ended.stderr


@pytest.mark.skipif(
    not ROBOT_ARM, reason="the DaISy robot arm data are not part of this project (set ROBOT_ARM_DATA)"
)
def test_the_robot_arm_is_predicted_as_its_page_says() -> None:
    ended = run("robot_arm.py", ROBOT_ARM)
    assert ended.returncode == 0, ended.stderr
    fits = re.findall(r"FIT ([\d.]+) %, on the second half ([\d.]+) %", ended.stdout)
    assert len(fits) == 2
    text = PAGE.read_text(encoding="utf-8")
    for (here, there), least in zip(fits, (96.0, 96.5), strict=True):
        assert float(there) >= least
        # Figures of the page, to the last digit but one: LAPACK's rounding differs.
        stated = re.search(rf"\| ({here[:-1]}\d) % \| \*\*({there[:-1]}\d) %\*\*", text)
        assert stated is not None, (here, there)
    assert "more than stated" in ended.stdout
