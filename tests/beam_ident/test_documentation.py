from __future__ import annotations

import numpy as np
import pytest

from tests.pages import run_page


@pytest.mark.slow
def test_the_page_on_transfer_functions_runs_from_top_to_bottom(capsys: pytest.CaptureFixture[str]) -> None:
    run_page("transfer-functions.md", 3)
    printed = capsys.readouterr().out
    assert "b0 = " in printed
    assert "ms" in printed


@pytest.mark.slow
@pytest.mark.parametrize("name", ["force-and-friction", "closed-loop"])
def test_a_page_on_a_hard_plant_runs_and_keeps_what_it_asserts(name: str) -> None:
    run_page(f"{name}.md")


@pytest.mark.slow
def test_the_page_on_results_finds_its_mode_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    found = run_page("results.md")["found"]
    assert found.modes()[0] == pytest.approx([20.0], rel=1e-3)  # type: ignore[attr-defined]
    assert "po_moesp" in capsys.readouterr().out


@pytest.mark.slow
def test_the_page_on_identification_runs_from_top_to_bottom(capsys: pytest.CaptureFixture[str]) -> None:
    namespace = run_page("identification.md", 3)
    printed = capsys.readouterr().out
    assert "peak travel" in printed
    assert "4.4" in printed
    assert "prediction: FIT" in printed
    omega = namespace["omega"]
    assert isinstance(omega, np.ndarray)
    np.testing.assert_allclose(omega / (2 * np.pi), [4.4, 28.3], rtol=5e-3)


@pytest.mark.slow
def test_the_page_on_live_identification_runs_and_ends_before_the_record_does(
    capsys: pytest.CaptureFixture[str],
) -> None:
    namespace = run_page("live.md", 3)
    printed = capsys.readouterr().out
    assert "known after" in printed
    assert float(printed.split()[-2]) == pytest.approx(4.4, rel=1e-3)
    assert namespace["now_s"] < 13.5
