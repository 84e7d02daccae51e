from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "identification.md"


def test_the_code_of_the_page_runs_from_top_to_bottom(capsys: pytest.CaptureFixture[str]) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) >= 7
    namespace: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), namespace)
    printed = capsys.readouterr().out
    assert "peak travel" in printed
    assert "4.4" in printed
    assert "prediction: FIT" in printed
    omega = namespace["omega"]
    assert isinstance(omega, np.ndarray)
    np.testing.assert_allclose(omega / (2 * np.pi), [4.4, 28.3], rtol=5e-3)
