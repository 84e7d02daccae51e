"""Parts of the firmware that no test of the whole sees: races, and numbers of the target's timers."""

from __future__ import annotations

import subprocess

import pytest

from tests.firmware.builds import built

pytestmark = pytest.mark.slow


def test_no_race_breaks_the_telemetry_and_every_number_fits_its_register():
    done = subprocess.run([str(built("units"))], capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.returncode) == ("", 0), done.stderr
