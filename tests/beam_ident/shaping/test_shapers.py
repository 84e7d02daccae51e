"""Shapers against what was published of them, and against an oscillator."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ident.errors import ExcitationError
from beam_ident.shaping.command import s_curve
from beam_ident.shaping.shapers import SHAPERS, ei, notched, shaped, smoothed, stretched, two_hump_ei, zvd
from tests.beam_ident.shaping.beams import LIMITS, OMEGAS, ZETAS, amplitude_after


def vibration(times: np.ndarray, amplitudes: np.ndarray, omega: float) -> float:
    """Return the share of an undamped mode's swing that impulses leave."""
    return float(abs(np.sum(amplitudes * np.exp(1j * omega * times))))


@pytest.mark.parametrize(("name", "left"), [("ZV", 0.0), ("ZVD", 0.0), ("EI", 0.05), ("two-hump EI", 0.0)])
def test_undamped_shapers_leave_at_their_mode_what_is_published(name: str, left: float) -> None:
    times, amplitudes = SHAPERS[name](10.0, 0.0)
    assert np.sum(amplitudes) == pytest.approx(1.0)
    # Two humps leave nothing at the middle but V: Singhose et al. (1997), figure 2.
    assert vibration(times, amplitudes, 10.0) == pytest.approx(left, abs=2e-3)


def test_two_humps_have_the_published_amplitudes() -> None:
    # Singhose, Porter, Tuttle and Singer (1997), table 1, V = 5 %, no damping: a fit, good to a thousandth.
    _, amplitudes = two_hump_ei(10.0, 0.0)
    assert amplitudes == pytest.approx([0.16054, 0.33946, 0.33946, 0.16054], abs=1e-3)


def test_a_zvd_is_flat_at_its_mode_and_an_ei_wider_below_five_per_cent() -> None:
    def width(shaper: object) -> float:
        times, amplitudes = shaper(10.0, 0.0)  # type: ignore[operator]
        near = np.linspace(10.0, 15.0, 4000)
        left = np.array([vibration(times, amplitudes, omega) for omega in near])
        return float(near[np.argmax(left > 0.0501)] / 10.0 - 1.0)

    # Singhose et al. (1994): insensitivity of 0.286 and 0.399 for both sides together.
    assert 2.0 * width(zvd) == pytest.approx(0.286, abs=0.01)
    assert 2.0 * width(ei) == pytest.approx(0.399, abs=0.01)


def test_a_damped_zv_stills_the_mode_that_it_is_for_and_one_for_two_modes_both() -> None:
    base = s_curve(0.01, LIMITS.axis, 2e-3)
    before = [amplitude_after(base, omega, zeta) for omega, zeta in zip(OMEGAS, ZETAS, strict=True)]
    move = shaped(base, "ZV", OMEGAS, ZETAS)
    after = [amplitude_after(move, omega, zeta) for omega, zeta in zip(OMEGAS, ZETAS, strict=True)]
    # What ticks leave of an impulse between them: (omega T)^2 / 8 of it at most.
    assert after[0] < 1e-3 * before[0]
    assert after[1] < 0.5 * (OMEGAS[1] * 2e-3) ** 2 * before[1]


def test_filters_and_a_slower_move_leave_less_than_the_base_does() -> None:
    base = s_curve(0.01, LIMITS.axis, 2e-3)
    pole = np.array([OMEGAS[0] * complex(-ZETAS[0], np.sqrt(1.0 - ZETAS[0] ** 2))])
    plain = abs(base.end_phasors(pole)[0])
    assert abs(smoothed(base, OMEGAS[0]).end_phasors(pole)[0]) < 0.02 * plain
    assert abs(notched(base, OMEGAS[0], ZETAS[0]).end_phasors(pole)[0]) < 0.02 * plain
    assert abs(stretched(0.01, LIMITS.axis, smoothed(base, OMEGAS[0])).end_phasors(pole)[0]) < 0.2 * plain


def test_a_mode_that_does_not_oscillate_and_an_unknown_shaper_are_refused() -> None:
    base = s_curve(0.01, LIMITS.axis, 1e-3)
    with pytest.raises(ExcitationError, match="do not oscillate"):
        shaped(base, "ZV", OMEGAS[:1], np.array([1.2]))
    with pytest.raises(ExcitationError, match="expected one of ZV"):
        shaped(base, "ZVX", OMEGAS, ZETAS)
