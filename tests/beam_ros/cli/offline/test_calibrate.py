from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from beam_ros.cli.offline.calibrate import _table, _tests
from beam_ros.vision.calibration.procedure import CalibrationPoint, fit_line


def test_the_reduced_chi_squared_counts_the_points_beyond_the_lines_two_numbers() -> None:
    # A pattern of mean zero and without slope over these positions: the line is exact, the pattern is left.
    positions, pattern = np.array([-0.03, -0.01, 0.01, 0.03]), np.array([1.0, -1.0, -1.0, 1.0])
    columns = 320.0 + 1500.0 * positions + 0.03 * pattern
    line = fit_line([CalibrationPoint(x, 0.0, u, 0.01, 100) for x, u in zip(positions, columns, strict=True)])
    fit: Any = SimpleNamespace(lines=(line,), calibration=SimpleNamespace(angle=0.0, angle_sd=1e-4))
    # Four residuals of three standard deviations, for 4 - 2 degrees of freedom.
    assert _tests(fit, ("tip",))["tip"]["reduced_chi_squared"] == pytest.approx(4 * 3.0**2 / 2, rel=1e-6)
    assert _table(fit, ("tip",))[-1].endswith(" 18.00")
