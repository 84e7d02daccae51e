"""Series from a sensor made of its physics: electrons that arrive by chance, pixels that respond differently, a
reading with noise of its own, rounding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beam_ros.vision.calibration.camera_noise import MIN_FRAMES, Series, photon_transfer
from beam_ros.vision.errors import CalibrationError

GAIN = 0.05  # grey levels per electron
BIAS, READ, PRNU = 6.0, 1.2, 0.01


class Sensor:
    def __init__(self, seed: int, shape: tuple[int, int] = (60, 80)) -> None:
        self.rng = np.random.default_rng(seed)
        self.response = 1.0 + PRNU * self.rng.standard_normal(shape)

    def series(self, grey: float | np.ndarray, n_frames: int = 16, gamma: float = 1.0) -> Series:
        frames = []
        for k in range(n_frames):
            # Lamps drift.
            light = np.clip(np.asarray(grey) - BIAS, 0.0, None) / GAIN * (1.0 + 0.002 * np.sin(k))
            electrons = self.rng.poisson(light * self.response)
            read = BIAS + GAIN * electrons + READ * self.rng.standard_normal(self.response.shape)
            read = 255.0 * np.clip(read / 255.0, 0.0, 1.0) ** gamma
            frames.append(np.clip(np.rint(read), 0, 255).astype(np.uint8))
        return Series.of(frames, "series")


@pytest.mark.slow
def test_gain_bias_read_noise_and_prnu_lie_within_their_stated_standard_deviations():
    z = []
    for seed in range(25):
        sensor = Sensor(seed)
        noise = photon_transfer([sensor.series(60.0), sensor.series(180.0)], sensor.series(0.0))
        assert noise.is_straight
        z.append(
            [
                (noise.per_grey - GAIN) / noise.per_grey_sd,
                (noise.variance - (READ**2 + 1 / 12 - GAIN * BIAS)) / noise.variance_sd,
                (noise.electrons_per_grey - 1 / GAIN) / noise.electrons_per_grey_sd,
                (noise.bias - BIAS) / noise.bias_sd,
                (noise.read_noise - READ) / noise.read_noise_sd,
                (noise.prnu - PRNU) / noise.prnu_sd,
                noise.curvature / noise.curvature_sd,
            ]
        )
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    # 25 values each: the RMS is known to 14 %; bounds at three of these, and up to 1.6 for the clipped light's tails.
    assert np.all(rms < 1.6)
    assert np.all(rms > 0.5)
    assert (noise.per_grey, noise.prnu) == pytest.approx((GAIN, PRNU), rel=0.1)


def test_one_scene_of_many_levels_is_enough_for_the_line():
    noise = photon_transfer([Sensor(1).series(np.tile(np.linspace(30.0, 200.0, 80), (60, 1)), 40)])
    assert noise.per_grey == pytest.approx(GAIN, abs=4 * noise.per_grey_sd)
    assert noise.per_grey_sd < 0.002
    assert (noise.bias, noise.read_noise) == (None, None)


def test_a_gamma_shows_as_a_bend():
    sensor = Sensor(2)
    noise = photon_transfer([sensor.series(grey, 40, gamma=0.65) for grey in (30.0, 90.0, 200.0)], None)
    assert not noise.is_straight


def test_what_cannot_show_the_noise_is_refused_with_a_remedy():
    sensor = Sensor(3)
    with pytest.raises(CalibrationError, match="expected at least 8 of one scene at rest: film longer"):
        sensor.series(60.0, MIN_FRAMES - 1)
    with pytest.raises(CalibrationError, match="film a dark and a bright even scene"):
        photon_transfer([sensor.series(60.0), sensor.series(61.0)])
    with pytest.raises(CalibrationError, match="film a dark and a bright even scene"):
        photon_transfer([sensor.series(400.0), sensor.series(400.0)])
    with pytest.raises(CalibrationError, match="give one series of one camera"):
        Series.of([np.zeros((4, 5), np.uint8), np.zeros((5, 4), np.uint8)], "series")
    calm = [np.full((60, 80), 200, np.uint8)] * 10
    with pytest.raises(CalibrationError, match="switch off the camera's denoising"):
        photon_transfer([sensor.series(40.0), Series.of(calm, "calm")])


def linear_series(rng, level, steps=1, shape=(60, 80), n_frames=16, white=255, name="series"):
    """Series of a linear sensor whose grey levels are so many times finer than those of 8 bits."""
    response = 1.0 + PRNU * np.random.default_rng(99).standard_normal(shape)
    dtype = np.uint8 if white == 255 else np.uint16
    frames = []
    for _ in range(n_frames):
        electrons = rng.poisson((level - BIAS) / GAIN * response)
        read = BIAS + GAIN * electrons + READ * rng.standard_normal(shape)
        frames.append(np.clip(np.rint(steps * read), 0, white).astype(dtype))
    return Series.of(frames, name)


def coarser(one: Series, steps: int) -> Series:
    """The same series in coarser grey levels, without rounding."""
    return replace(one, mean=one.mean / steps, variance=one.variance / steps**2, white=one.white / steps)


def test_a_linear_sensor_is_straight_at_any_depth():
    z = []
    for seed in range(9):
        rng = np.random.default_rng([seed, 16])
        fine = [linear_series(rng, level, 257, white=65535) for level in (46.0, 96.0, 156.0)]
        noise = photon_transfer(fine)
        z.append(
            [noise.curvature / noise.curvature_sd, (noise.per_grey / 257 - GAIN) / noise.per_grey_sd * 257]
        )
        # Grey levels that are so many times finer have so many times the gain, whatever the computer's numbers are.
        again = photon_transfer([coarser(one, 257) for one in fine])
        assert again.per_grey * 257 == pytest.approx(noise.per_grey, rel=1e-2)
        assert again.curvature == pytest.approx(noise.curvature, abs=0.1 * noise.curvature_sd)
    # 9 values each: an RMS is known to 24 %; 2.5 of these.
    assert np.all(np.sqrt(np.mean(np.square(z), axis=0)) < 1.6)


def test_a_bend_that_two_levels_leave_open_is_not_stated():
    rng = np.random.default_rng(0)
    frames = [
        np.full((15, 20), level) + rng.integers(0, 2, (15, 20)) for level in (40, 90) for _ in range(20)
    ]
    low = [frame.astype(np.uint8) for frame in frames[:20]]
    high = [(frame + rng.integers(0, 4, frame.shape)).astype(np.uint8) for frame in frames[20:]]
    noise = photon_transfer([Series.of(low, "low"), *[Series.of(high, "high")] * 2])
    assert (noise.curvature, noise.curvature_sd) == (0.0, np.inf)


@pytest.mark.parametrize(("white", "steps"), [(255, 1), (4095, 16), (65520, 257)])
@pytest.mark.parametrize("level", [247.0, 262.0, 400.0])
def test_the_prnu_is_taken_from_the_brightest_series_that_is_not_saturated(level, white, steps):
    rng = np.random.default_rng([white, int(level)])
    lit = [linear_series(rng, grey, steps, white=white, name=f"at {grey}") for grey in (60.0, 160.0, level)]
    noise = photon_transfer(lit, linear_series(rng, BIAS, steps, white=white, name="dark"))
    assert noise.prnu == pytest.approx(PRNU, abs=4 * noise.prnu_sd)
    assert (noise.prnu, noise.prnu_sd) == lit[1].pattern(noise.bias)
    assert noise.prnu_sd < 0.05 * PRNU
    assert noise.per_grey / steps == pytest.approx(GAIN, abs=4 * noise.per_grey_sd / steps)
    (warning,) = noise.warnings
    assert f" % of its pixels is cut off at white ({white})" in warning
    assert warning.startswith((f"at {level}: noise of 9", f"at {level}: noise of 100 %"))
    assert warning.endswith("film it darker")


def test_a_part_that_is_saturated_is_left_out_and_named():
    rng = np.random.default_rng(4)
    scene = np.full((60, 80), 150.0)
    scene[:, :16] = 400.0
    noise = photon_transfer([linear_series(rng, 60.0), linear_series(rng, scene)], linear_series(rng, BIAS))
    assert noise.prnu == pytest.approx(PRNU, abs=4 * noise.prnu_sd)
    assert "noise of 20 % of its pixels is cut off at white" in noise.warnings[0]


def test_where_no_series_shows_the_prnu_none_is_stated():
    rng = np.random.default_rng(5)
    halves = [np.full((60, 80), level) for level in (60.0, 160.0)]
    for half in halves:
        half[:, 36:] = 400.0
    noise = photon_transfer([linear_series(rng, half) for half in halves])
    assert (noise.prnu, noise.prnu_sd) == (None, None)
    assert noise.per_grey == pytest.approx(GAIN, abs=4 * noise.per_grey_sd)
    assert "no series shows the PRNU" in noise.warnings[-1]
    small = [linear_series(rng, level, shape=(14, 40)) for level in (60.0, 110.0, 160.0)]
    assert photon_transfer(small).prnu is None


def test_series_that_do_not_belong_together_are_refused():
    rng = np.random.default_rng(6)
    dim, bright, dark = (linear_series(rng, level, name=f"at {level}") for level in (60.0, 160.0, BIAS))
    with pytest.raises(CalibrationError, match=r"at 160\.0: has level 160\.0.*give --dark the frames"):
        photon_transfer([dark, dim], bright)
    # A series of the same light as the dark one is as dark, within its noise.
    assert photon_transfer([dim, bright, linear_series(rng, BIAS)], dark).bias == pytest.approx(BIAS, abs=0.1)
    fine = linear_series(rng, 60.0, 257, white=65535, name="fine")
    with pytest.raises(
        CalibrationError, match="fine: frames are 80 x 60 of 16 bits; expected 80 x 60 of 8 bits"
    ):
        photon_transfer([dim, fine])
    with pytest.raises(
        CalibrationError, match=r"80 x 60 of 8 bits, as those of at 60\.0: give series of one"
    ):
        photon_transfer([dim, bright], linear_series(rng, BIAS, shape=(30, 40)))
    with pytest.raises(CalibrationError, match=r"frame 1 has shape .* and 16 bits; expected .* and 8"):
        Series.of([np.zeros((4, 5), np.uint8), np.zeros((4, 5), np.uint16)], "series")


def test_frames_that_repeat_the_one_before_do_not_count():
    rng = np.random.default_rng(7)
    frames = [(100 + rng.integers(0, 9, (60, 80))).astype(np.uint8) for _ in range(10)]
    once = Series.of(frames, "once")
    twice = Series.of([frame for frame in frames for _ in range(2)], "twice")
    assert (twice.n_frames, twice.n_repeated) == (10, 10)
    assert np.array_equal(twice.variance, once.variance)
    noise = photon_transfer([twice, linear_series(rng, 40.0)])
    assert noise.warnings == (
        "twice: 10 frames repeat the one before bit for bit and are left out; film without copies",
    )
    with pytest.raises(CalibrationError, match="holds 1 frames and 9 that repeat the one before"):
        Series.of(frames[:1] * 10, "copies")


def test_a_dark_series_in_its_own_noise_at_black_is_named():
    rng = np.random.default_rng(8)
    crushed = Series.of(
        [np.clip(np.rint(READ * rng.standard_normal((60, 80))), 0, 255).astype(np.uint8) for _ in range(16)],
        "crushed",
    )
    noise = photon_transfer([linear_series(rng, 60.0), linear_series(rng, 160.0)], crushed)
    assert "crushed: the dark level" in noise.warnings[0]
    assert "raise the camera's black level" in noise.warnings[0]
