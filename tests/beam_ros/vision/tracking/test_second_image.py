from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.tracking.appearance import Appearance
from beam_ros.vision.tracking.disc_model import DiscFit
from beam_ros.vision.tracking.second_image import (
    AT_REST,
    Disc,
    Motion,
    SecondImages,
    Sighting,
    is_explained,
    pull,
    usual_pull,
)

SIGMA = 0.02
"""Standard deviation of a second moment [px^2]: that of a disc of 12 px at a noise of 2 grey levels."""
EXPOSED = 0.5
"""Exposure over the time between two frames."""


def disc(excess: float, tilt: float = 0.0, sigma: float = SIGMA) -> DiscFit:
    return DiscFit(0, 0, 0, 100, 0, excess, tilt, sigma)


def settled(excess: float = 0.0, tilt: float = 0.0, frames: int = 32) -> Appearance:
    return Appearance(100.0, 9.0, 9.0, 0.0, 0.0, 50.0, frames=frames, excess=excess, tilt=tilt)


@pytest.mark.parametrize("angle", [0.0, 0.4, -0.7, 1.2])
def test_the_pull_of_a_second_image_is_its_second_moment_along_u(angle):
    cos, sin, moment = np.cos(angle), np.sin(angle), 0.1

    def of(moment: float, motion: Motion = AT_REST, sigma: float = 1e-6) -> float:
        excess, tilt = moment * (cos**2 - sin**2) + 0.02, 2 * moment * cos * sin - 0.03
        return pull(disc(excess, tilt, sigma), motion, settled(0.02, -0.03))

    assert of(moment) == pytest.approx(np.sqrt(moment) * abs(cos))
    # The standard deviation of the moment along u is sigma |cos|; noise explains four of it.
    assert of(moment, sigma=moment * abs(cos) / 3.9) == 0.0
    assert of(moment, sigma=moment * abs(cos) / 4.1) > 0.0
    assert of(moment, Motion(np.sqrt(12.0), 1.0)) == 0.0


@pytest.mark.parametrize(
    ("farthest", "lowest", "highest"), [(8.0, 0.9, 1.1), (2.0, 0.8, 1.2), (0.5, 0.5, 1.2)]
)
def test_the_usual_pull_is_a_standard_deviation(farthest, lowest, highest):
    rng, scores = np.random.default_rng(6), []
    for share, aside, angle in rng.random((4000, 3)) * [0.5, farthest, np.pi]:
        moment = share * (1 - share) * aside**2
        excess, tilt = moment * np.cos(2 * angle), moment * np.sin(2 * angle)
        found = disc(*([excess, tilt] + SIGMA * rng.standard_normal(2)))
        scores.append(share * aside * np.cos(angle) / usual_pull(found, AT_REST, settled()))
    # Where most second images lie so near that the noise hides them, it may be too large.
    assert lowest < np.sqrt(np.mean(np.square(scores))) < highest


def test_a_rolling_shutter_tilts_a_disc_by_its_height():
    found = disc(0.0, 0.6, 1e-6)
    assert pull(found, Motion(0.0, 0.6 / 18 * 1.001), settled()) == 0.0
    assert pull(found, Motion(0.0, 0.0), settled()) == pytest.approx(np.sqrt(0.3))


def test_what_a_smear_explains_is_never_a_second_image():
    rng = np.random.default_rng(3)
    n_explained = 0
    for excess, tilt, step in rng.normal(size=(2000, 3)) * [0.1, 0.1, 4.0]:
        if is_explained(disc(excess, tilt), settled(), step, EXPOSED):
            n_explained += 1
            assert pull(disc(excess, tilt), Motion(EXPOSED * step, 0.0), settled()) == 0.0
    assert n_explained > 500


@pytest.mark.parametrize(("step", "sigmas"), [(0.1, 3.0), (0.2, 1.0), (0.35, 1.0), (0.5, 3.0)])
def test_a_moment_explains_less_where_a_frame_before_would_add_about_as_much(step, sigmas):
    smear = (EXPOSED * step) ** 2 / 12
    assert is_explained(disc(smear + 0.99 * sigmas * SIGMA), settled(), step, EXPOSED)
    assert not is_explained(disc(smear + 1.01 * sigmas * SIGMA), settled(), step, EXPOSED)


def sighting(
    step: float, share: float, rng: np.random.Generator, speed: float | None = None, doubt: float = 0.0
) -> Sighting:
    """A marker in a frame that holds so much of the frame before; step and speed are the true ones [px per frame]."""
    speed = step if speed is None else speed
    excess = share * (1 - share) * step**2 + (EXPOSED * speed) ** 2 / 12 + SIGMA * rng.standard_normal()
    return Sighting(disc(excess), settled(), 0.0, (1 - share) * step, abs(speed), doubt, False)


def judged(seconds: SecondImages, sightings: list[Sighting], *, is_seen: bool = False) -> list[float]:
    return [each.centre_px for each in seconds.pulls(sightings, 1.0, is_seen=is_seen)]


@pytest.mark.parametrize("share", [0.2, 0.35, 0.5])
def test_a_blended_frame_is_told_by_all_markers_and_stated_for_each(share):
    rng = np.random.default_rng(1)
    # The one in the middle shows the frame before; of the others neither does by itself.
    steps = (0.3, 1.6, -0.5)
    pulled = np.array(
        [judged(SecondImages(EXPOSED, 0.0), [sighting(d, share, rng) for d in steps]) for _ in range(100)]
    )
    for k, step in enumerate(steps):
        stated = np.where(np.isfinite(pulled[:, k]), pulled[:, k], 0.35)
        assert 0.6 * min(share * abs(step), 0.35) <= np.median(stated) <= 0.35


def test_frames_that_are_not_blended_are_hardly_less_certain():
    rng, seconds = np.random.default_rng(2), SecondImages(EXPOSED, 0.0)
    pulled = [
        judged(seconds, [sighting(d, 0.0, rng) for d in rng.normal(size=3) * [0.5, 2.0, 4.0]])
        for _ in range(2000)
    ]
    assert np.mean(np.array(pulled) > 0.01) < 0.005
    assert np.max(pulled) < 0.35
    assert not seconds.is_usual


def test_a_speed_that_is_not_known_explains_as_much_as_it_may():
    rng = np.random.default_rng(4)
    turning = [sighting(1.0, 0.0, rng, speed=6.0), sighting(0.1, 0.0, rng)]
    assert max(judged(SecondImages(EXPOSED, 0.0), turning)) < 0.01
    unknown = [turning[0]._replace(speed=1.0, doubt=5.0), turning[1]]
    # It may be the frame before, too: up to one pixel, which is six standard deviations.
    assert max(judged(SecondImages(EXPOSED, 0.0), unknown)) < 0.17
    assert judged(SecondImages(EXPOSED, 0.0), [turning[0]._replace(speed=1.0), turning[1]])[0] == np.inf


def test_where_frames_are_blended_now_and_then_a_frame_that_does_not_tell_is_stated_by_that():
    rng, seconds = np.random.default_rng(5), SecondImages(EXPOSED, 0.0)
    slow = [sighting(0.2, 0.0, rng)._replace(found=disc(0.0))]
    # One frame in a hundred may be blended, with a share up to the whole of the step.
    assert judged(seconds, slow)[0] < 0.2 * np.sqrt(0.01 / 3)
    shares = [0.4 * (k % 5 == 0) for k in range(100)]
    for share in shares:
        seconds.pulls([sighting(2.0, share, rng)], 1.0, is_seen=False)
    assert seconds.is_usual
    # A fifth of the frames, and a share between none and all of a step that the moment does not exclude.
    assert 0.02 < judged(seconds, slow)[0] < 0.2 * 0.6
    # A marker whose step is not known is pulled by what its second moment allows, one that is far from there is not.
    lost = Sighting(disc((EXPOSED * 4.5) ** 2 / 12), settled(), 0.0, np.nan, 4.5, 0.0, False)
    assert judged(seconds, [sighting(2.0, 0.4, rng), lost])[1] == np.inf
    assert judged(seconds, [sighting(2.0, 0.4, rng), lost._replace(step=0.0)])[1] == 0.0


@pytest.mark.parametrize("share", [0.2, 0.35, 0.5])
def test_the_pulls_of_a_film_with_blended_frames_are_as_large_as_is_stated(share):
    rng, scores = np.random.default_rng(7), []
    for _ in range(40):
        seconds, place = SecondImages(EXPOSED, 0.0), 0.006 * rng.standard_normal((60, 3))
        for k, steps in enumerate(rng.normal(size=(60, 3)) * [0.2, 0.5, 0.8]):
            held = share * (rng.random() < 0.2)
            pulled = np.array(judged(seconds, [sighting(d, held, rng) for d in steps]))
            if k >= 20:
                scores.extend(
                    (held * steps + place[k])[np.isfinite(pulled)]
                    / np.hypot(0.006, pulled[np.isfinite(pulled)])
                )
    # Of 4800 errors some 30 are pulls of which the moments do not tell: the RMS is known to a tenth.
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.3


def test_the_place_of_a_marker_in_a_blended_frame_is_known_from_its_pull():
    rng, seconds = np.random.default_rng(8), SecondImages(EXPOSED, 0.0)
    shown = [sighting(2.0, 0.3, rng), sighting(-1.5, 0.3, rng)]
    assert [each.behind_px for each in seconds.pulls(shown, 1.0, is_seen=False)] == pytest.approx(
        [0.6, -0.45], abs=0.1
    )
    shown = [sighting(2.0, 0.0, rng), sighting(-1.5, 0.0, rng)]
    assert [each.behind_px for each in seconds.pulls(shown, 1.0, is_seen=False)] == pytest.approx(
        [0.0, 0.0], abs=1e-3
    )


@pytest.mark.parametrize("is_among_them", [True, False])
def test_a_second_image_of_one_marker_lies_over_all(is_among_them):
    # This one was found with a second image over it, and moves as fast as that may be a smear.
    found = Sighting(disc(0.4), settled(0.2), 0.0, 0.0, 1.0, 3.0, False)
    assert judged(SecondImages(EXPOSED, 0.0), [found]) == [0.0]
    shown = [found._replace(found=disc(0.6), speed=0.0, doubt=0.0)] if is_among_them else []
    pulled = judged(SecondImages(EXPOSED, 0.0), [found, *shown], is_seen=not is_among_them)
    # The noise adds a tenth of a percent.
    assert pulled[0] == pytest.approx(np.sqrt(0.4 * (2 * np.log(2) - 1)), rel=2e-3)


def resting(excess: float, frames: int, step: float = 0.0, *, was_pulled: bool = False) -> Sighting:
    """A marker that hardly moves, with so much excess that its look holds, too."""
    return Sighting(disc(excess), settled(excess, frames=frames), 0.0, step, abs(step), 0.0, was_pulled)


def test_a_marker_that_comes_back_at_an_unknown_speed_may_have_a_second_image():
    for excess, stated in ((0.3, np.sqrt(0.3 * (2 * np.log(2) - 1))), (0.05, 0.0)):
        found = Sighting(disc(excess), settled(), 0.0, np.nan, 3.0, 3.0, False)
        assert judged(SecondImages(EXPOSED, 0.0), [found])[0] == pytest.approx(stated, rel=3e-3)


def test_a_look_that_is_not_settled_may_hold_a_reflection():
    for frames, is_stated in ((2, True), (31, True), (32, False)):
        pulled = judged(SecondImages(EXPOSED, 0.0), [resting(0.2, frames), resting(0.0, 32)])
        assert pulled == [pytest.approx(0.28, abs=0.01) if is_stated else 0.0, 0.0]


def test_a_reflection_that_was_seen_may_lie_over_any_marker_for_a_hundred_frames():
    seconds = SecondImages(EXPOSED, 0.0)
    seconds.pulls([resting(0.2, 2)], 1.0, is_seen=False)
    assert not seconds.is_usual
    seconds.pulls([resting(0.2, 3, was_pulled=True)], 1.0, is_seen=False)
    for k in range(100):
        assert seconds.is_usual
        hidden, settled_look = judged(seconds, [resting(0.0, 32), resting(0.2, 32)])
        # What the noise hides of it is a part of that.
        assert (hidden, settled_look) == ((0.0, 0.0) if k == 99 else pytest.approx((0.06, 0.28), abs=0.01))


def test_a_frame_before_is_no_reflection():
    # Seen twice in a row, it lies where the marker was.
    for step, is_reflection in ((0.3, True), (0.6, False)):
        seconds = SecondImages(EXPOSED, 0.0)
        shown = Sighting(disc(0.2), settled(), 0.0, step, abs(step), 0.0, True)
        seconds.pulls([shown], 1.0, is_seen=False)
        assert seconds.is_usual
        for _ in range(2):
            pulled = judged(seconds, [resting(0.0, 32)])
        assert (pulled[0] > 0.0) == is_reflection


def test_a_marker_that_shows_a_second_image_far_aside_is_not_believed():
    limit = 0.1225 + 5 * SIGMA
    for moment, is_believed in ((0.99 * limit, True), (1.01 * limit, False)):
        sight = Sighting(disc(moment), settled(), 0.0, np.nan, 0.0, 0.0, False)
        assert np.isfinite(judged(SecondImages(EXPOSED, 0.0), [sight])[0]) == is_believed


def test_a_disc_of_known_aspect_is_compared_with_that():
    assert pull(disc(0.3), AT_REST, Disc(0.3, 0.0, 9.0)) == 0.0


@pytest.mark.parametrize("longer", [1.0, 1.2, 1.5])
def test_smears_show_another_exposure_only_where_few_are_too_short_for_it(longer):
    # Where a motion turns, one speed in five is a quarter more than the places tell.
    exposed_s, since_s, rng = 0.004, 0.01, np.random.default_rng(6)
    seconds, look = SecondImages(exposed_s, 0.0), settled()
    for _ in range(2000):
        speed = rng.uniform(8.0, 20.0)
        smear = longer * exposed_s / since_s * speed * (1.25 if rng.random() < 0.2 else 1.0)
        found = disc(smear**2 / 12 + SIGMA * rng.standard_normal())
        if is_explained(found, look, speed, exposed_s / since_s):
            seconds.note_explained(SIGMA, speed, since_s)
        else:
            seconds.pulls([Sighting(found, look, 0.0, speed, speed, 0.0, False)], since_s, is_seen=False)
    assert seconds.exposure_s == (exposed_s if longer == 1.0 else pytest.approx(longer * exposed_s, rel=0.2))
