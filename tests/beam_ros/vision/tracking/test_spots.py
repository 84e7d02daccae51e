"""A disc of whole pixels, whose centre and light are known exactly, measured where it is not looked for exactly."""

from __future__ import annotations

import numpy as np
import pytest

from beam_ros.vision.tracking import spots
from beam_ros.vision.tracking.appearance import UNSMEARED, Appearance, Light
from beam_ros.vision.tracking.spots import SpotMeter
from tests.beam_ros.vision.packaged_rig import packaged_tracker

LEVEL, SPECK, DISC = 30, 1, 100


@pytest.mark.parametrize("polarity", ["bright", "dark"])
@pytest.mark.parametrize(("u", "v"), [(60, 50), (60, 10), (89, 50)])  # the last two are near an edge
def test_what_noise_leaves_everywhere_pulls_no_spot(polarity, u, v):
    rows, columns = np.mgrid[:100, :100]
    is_disc = (columns - u) ** 2 + (rows - v) ** 2 <= 36
    light = Light(packaged_tracker(polarity=polarity), 20.0, 110.0, 2.0)
    light.level, light.speck = float(LEVEL), float(SPECK)
    image = (LEVEL + SPECK + DISC * is_disc).astype(np.uint8)
    if polarity == "dark":
        light.level, image = 255.0 - LEVEL, 255 - image
    meter = SpotMeter(packaged_tracker(polarity=polarity))
    for column, row in ((u, v), (u + 1.4, v - 1.3), (u - 1.2, v + 1.4)):
        spot, reason = meter.measure(image, column, row, light)
        assert reason == "ok"
        assert (spot.u, spot.v) == pytest.approx((u, v), abs=1e-9)
        assert spot.mass == pytest.approx(DISC * np.count_nonzero(is_disc), rel=1e-12)


@pytest.mark.parametrize(("u", "v"), [(7.5, 50.5), (91.5, 50.5), (50.5, 7.5), (50.5, 91.5)])
def test_a_spot_counts_up_to_a_pixel_from_the_edge(u, v):
    rows, columns = np.mgrid[:100, :100]
    meter, light = SpotMeter(packaged_tracker()), Light(packaged_tracker(), 20.0, 110.0, 0.0)

    def reason(u, v):
        is_disc = (columns - u) ** 2 + (rows - v) ** 2 <= 36
        return meter.measure((20 + 110 * is_disc).astype(np.uint8), u, v, light)[1]

    outwards = np.sign([u - 50.5, v - 50.5])
    assert reason(u, v) == "ok"
    assert reason(u + outwards[0], v + outwards[1]) == "border"


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_a_thread_on_one_side_is_no_noise_of_the_background(is_mirrored):
    rows, columns = np.mgrid[:100, :100]
    image = 20 + 110 * ((columns - 50) ** 2 + (rows - 50) ** 2 <= 36)
    image = image + np.rint(2.0 * np.random.default_rng(1).standard_normal(image.shape)).astype(int)
    meter = SpotMeter(packaged_tracker())
    spot, _ = meter.measure(image.astype(np.uint8), 50.0, 50.0, Light(meter.parameters, 20.0, 110.0, 2.0))
    image[np.abs(columns - spot.region[2] + rows - 50) < 3] = 90
    if is_mirrored:
        image = image[:, ::-1]
        left, top, right, bottom = spot.region
        spot = spot._replace(region=(100 - right, top, 100 - left, bottom))
    # The other side shows the noise to a fifth; the thread's own variance is some hundred times as much.
    assert meter.sides(image.astype(np.uint8), spot).variance < 9.0 * (2.0**2 + 1 / 12)


def test_light_that_only_grows_is_followed_through_four_regions_and_no_further():
    # Seen through any region of 29 pixels, exp(x / 20) has its centre of gravity by the same way to the right.
    image = np.tile(np.rint(100.0 * np.exp(np.arange(100) / 20.0)).astype(np.uint16), (100, 1))
    ways = np.arange(-14, 15)
    way = float(np.average(ways, weights=np.exp(ways / 20.0)))
    light = Light(packaged_tracker(), 0.0, 1.0, 0.0)
    light.level = 0.0
    spot, _ = SpotMeter(packaged_tracker()).measure(image, 20.0, 50.0, light)
    start = 20
    for _ in range(3):
        start = round(start + way)
    assert spot.region[0] == start - 14
    assert (spot.u, spot.v) == pytest.approx((start + way, 50.0), abs=0.02)  # of rounding the grey levels


def test_what_is_darker_than_four_deviations_of_the_noise_pulls_no_more_than_that():
    rows, columns = np.mgrid[:100, :100]
    image = (20 + 110 * ((columns - 50) ** 2 + (rows - 50) ** 2 <= 36)).astype(np.uint8)
    light = Light(packaged_tracker(), 20.0, 110.0, 2.0)
    meter = SpotMeter(packaged_tracker())
    spot, _ = meter.measure(image, 50.0, 50.0, light)
    appearance = Appearance(spot.area, spot.variance_u, spot.variance_v, 0.0, 0.0, 50.0)

    def centre(grey: int) -> float:
        image[48:53, 57:60] = grey
        return meter.centre(image, spot, light, appearance)[0]

    assert centre(20) == pytest.approx(50.0, abs=1e-6)
    assert centre(13) < centre(20)
    assert centre(12) < centre(13)
    assert centre(0) == centre(12)


@pytest.mark.parametrize("refinement", ["disc_model", "radial_symmetry"])
def test_a_smeared_disc_is_refined_over_its_whole_length(refinement):
    rows, columns = np.mgrid[:100, :100]
    light = Light(packaged_tracker(), 20.0, 110.0, 0.5)

    def seen(ways: np.ndarray) -> np.ndarray:
        discs = [(columns - 50 - way) ** 2 + (rows - 50) ** 2 <= 36 for way in ways]
        return np.rint(20 + 110 * np.mean(discs, axis=0)).astype(np.uint8)

    still, image = seen(np.zeros(1)), seen(np.linspace(-4.0, 4.0, 33))
    meter = SpotMeter(packaged_tracker(refinement=refinement))
    own, _ = meter.measure(still, 50.0, 50.0, light)
    appearance = Appearance(own.area, own.variance_u, own.variance_v, 0.0, 0.0, 50.0)
    spot, _ = meter.measure(image, 50.0, 50.0, light)
    assert meter.refine(image, spot, light, appearance)[:2] == pytest.approx((50.0, 50.0), abs=1e-3)


@pytest.mark.parametrize("polarity", ["bright", "dark"])
def test_a_row_is_empty_beside_a_marker_only_where_a_search_finds_nothing_there(polarity):
    rng = np.random.default_rng(1)
    meter, own, n_alone = SpotMeter(packaged_tracker(polarity=polarity)), 70.3, 0
    for _ in range(400):
        image = np.full((40, 140), 20, np.uint8)
        image[14:27, 65:77] = 200
        for _ in range(rng.integers(0, 3)):
            width, height = rng.integers(1, 16, 2)
            x, y = rng.integers(55, 85), rng.integers(0, 25)
            image[y : y + height, x : x + width] = 200
        light = Light(meter.parameters, 20.0, 180.0, 1.0)
        if polarity == "dark":
            image, light = 255 - image, Light(meter.parameters, 235.0, 180.0, 1.0)
        relief = meter.relief(image)
        is_alone = meter.is_alone(image, light, 90.0, own)
        n_alone += is_alone
        if is_alone:
            assert all(abs(place.u - own) < meter.radius for place in meter.centres(relief, 90.0))
    assert 40 < n_alone < 360


@pytest.mark.slow
def test_a_camera_that_shows_noise_alone_costs_no_search_for_smears(monkeypatch):
    # A thousand spots a frame, a millisecond and a half each: half a second for every frame of a covered lens.
    searches = []
    monkeypatch.setattr(spots, "smear_of", lambda *look: searches.append(look) or UNSMEARED)
    image = np.random.default_rng(1).integers(0, 256, (480, 640)).astype(np.uint8)
    meter = SpotMeter(packaged_tracker())
    relief = meter.relief(image)
    found = [
        meter.candidate(image, place.u, place.v, place.ground)
        for share in (0.4, 0.5, 0.6)
        for place in meter.centres(relief, share * relief.most)
    ]
    assert len(found) > 20
    assert not any(found)
    assert len(searches) <= 1
