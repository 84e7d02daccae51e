"""The tracker's machine code (`BEAM_COMPILE=1`, see setup.py) measures what its source does."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

from beam_ros.vision.tracking import tracker

ROOT = Path(__file__).parents[2]

MEASURE = """
import sys
from importlib.util import spec_from_file_location

class FromSource:
    def find_spec(name, path=None, target=None):
        if name.startswith("beam_ros.vision.tracking."):
            return spec_from_file_location(name, name.replace(".", "/") + ".py")

if sys.argv[1] == "source":
    sys.meta_path.insert(0, FromSource)

import numpy as np
from beam_ros.vision.tracking import tracker
from benchmarks.vision_scenes import CLASSES, pictures, suite

print(tracker.__file__, file=sys.stderr)
for kind in sys.argv[2:]:
    rng = np.random.default_rng(20)
    scene = CLASSES[kind](rng)
    for columns, deviations, reasons in suite(scene, list(pictures(scene, rng))):
        print(kind, *np.round(columns, 6), *np.round(deviations, 8), *reasons)
"""
"""Print what the suite makes of random scenes, a line a frame, by the modules' source or by what is built of it."""


def measured(by: str, *kinds: str) -> list[str]:
    program = [sys.executable, "-c", MEASURE, by, *kinds]
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip().endswith(".py") == (by == "source")
    return done.stdout.splitlines()


def test_machine_code_measures_what_the_source_does() -> None:
    if not tracker.__file__.endswith(tuple(EXTENSION_SUFFIXES)):
        pytest.skip("the tracker is not built as machine code here; `make test-compiled` does that")
    kinds = "twin_moving", "cover", "light_step", "textured", "interlaced"
    found = measured("machine code", *kinds)
    assert len(found) >= 400
    assert sum("ok" in line for line in found) > 200
    assert found == measured("source", *kinds)


@pytest.mark.first_case
@pytest.mark.parametrize(
    ("command", "complaint"),
    [
        ("editable_wheel", "leave out -e, or --symlink-install"),
        ("develop", "leave out -e, or --symlink-install"),
        ("bdist_wheel", "pip install 'mypy"),
    ],
)
def test_a_build_that_would_mislead_is_refused_with_the_remedy(command: str, complaint: str) -> None:
    program = f"""
import runpy, sys
sys.modules["mypyc"] = None
sys.argv = ["setup.py", "{command}"]
runpy.run_path("setup.py")
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env={**os.environ, "BEAM_COMPILE": "1"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1
    assert done.stderr.startswith("BEAM_COMPILE is 1 "), done.stderr
    assert complaint in done.stderr
    assert "Traceback" not in done.stderr
