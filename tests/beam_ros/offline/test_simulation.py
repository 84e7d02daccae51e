"""The experiment without ROS: into a bag, back out of it, and to the model that it was made from."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beam_ident import ModalModel
from beam_ros.bags.batches import decode_batch, encode_batch
from beam_ros.bags.errors import BagError, BagExistsError, MissingTopicsError
from beam_ros.bags.reading import Bag
from beam_ros.bags.writing import BagWriter
from beam_ros.errors import UsageError
from beam_ros.interfaces.imperfections import PRESETS
from beam_ros.offline.identification import identification_of_bags, write_models
from beam_ros.offline.identification_summary import format_table
from beam_ros.offline.loading.described_rig import described_rig
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.offline.loading.options import FitOptions
from beam_ros.offline.simulation import simulate
from beam_ros.rig.rig import Rig

SHORT = {"excitation.duration": 6.0, "excitation.still": 2.0, "excitation.end_frequency": 45.0}


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig.from_file().with_values(SHORT)


@pytest.fixture(scope="module")
def bag(rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "bag"
    simulate(rig, path)
    return path


@pytest.mark.slow
def test_the_identified_poles_are_the_models_own(rig: Rig, bag: Path) -> None:
    result = identification_of_bags(bag).content
    truth = rig.beam_model().natural_frequencies / (2 * math.pi)
    assert result["converged"]
    assert len(result["modes"]) == 2
    for k, mode in enumerate(result["modes"]):
        assert mode["frequency_hz"] == pytest.approx(truth[k], rel=3e-3)
        assert mode["damping_ratio"] == pytest.approx(0.005, rel=0.15)
        assert abs(mode["frequency_z"]) < 4
        assert abs(mode["damping_ratio_z"]) < 4


@pytest.mark.slow
def test_the_same_seed_gives_the_same_messages_and_another_one_other_noise(
    rig: Rig, bag: Path, tmp_path: Path
) -> None:
    simulate(rig, tmp_path / "again")
    simulate(rig.with_values({"simulation.seed": 2}), tmp_path / "other")
    positions = []
    for path in (bag, tmp_path / "again", tmp_path / "other"):
        with Bag(path) as opened:
            positions.append(opened.displacements().positions)
    assert np.array_equal(positions[0], positions[1])
    assert np.std(positions[0] - positions[2]) == pytest.approx(5e-6 * math.sqrt(2), rel=0.1)


@pytest.mark.slow
def test_rendered_and_tracked_frames_agree_with_the_truth(rig: Rig, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    short = rig.with_values({"excitation.duration": 2.0, "excitation.still": 0.2})
    simulate(short, tmp_path / "camera", with_camera=True)
    done: list[tuple[float, float]] = []
    quiet = short.with_values({"simulation.displacement_noise": 0.0})
    simulate(quiet, tmp_path / "truth", on_progress=lambda *progress: done.append(progress))
    # A step is 10 ms, and the sequence ends within a few of them after its last sample.
    assert done[0][0] == pytest.approx(0.01, abs=0.005)
    assert done[-1][0] == pytest.approx(done[-1][1], abs=0.1)
    with Bag(tmp_path / "camera") as camera, Bag(tmp_path / "truth") as truth:
        error = camera.displacements().positions - truth.displacements().positions
        # 0.006 px (the tracker's figure at this noise) at 1500 px/m is 4 um.
        # A calibration is made from what the markers' topic says beside the displacements.
        assert camera.count("beam/markers") == camera.count("beam/displacement")
        assert truth.count("beam/markers") == 0
    assert np.all(np.sqrt(np.mean(error**2, axis=0)) < 4.5e-6)


@pytest.mark.slow
def test_tracked_frames_are_measured_with_the_rigs_own_calibration(rig: Rig, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    from beam_ros.vision.calibration.linear import LinearCalibration
    from beam_ros.vision.calibration.storage import save_calibration
    from beam_ros.vision.errors import CalibrationError

    short = rig.with_values({"excitation.duration": 0.5, "excitation.still": 0.1})
    nominal = rig.camera_parameters()
    for name, camera in (
        ("double", replace(nominal, pixels_per_metre=nominal.pixels_per_metre / 2)),
        ("wider", replace(nominal, width=2 * nominal.width)),
    ):
        save_calibration(LinearCalibration.from_camera(camera, 3), tmp_path / f"{name}.yaml")
    simulate(short, tmp_path / "nominal", with_camera=True)
    told = short.with_values({"tracker.calibration": str(tmp_path / "double.yaml")})
    simulate(told, tmp_path / "told", with_camera=True)
    with Bag(tmp_path / "nominal") as one, Bag(tmp_path / "told") as other:
        np.testing.assert_allclose(
            np.diff(other.displacements().positions, axis=0),
            2.0 * np.diff(one.displacements().positions, axis=0),
            atol=1e-12,
        )
    for name in ("wider", "absent"):
        told = short.with_values({"tracker.calibration": str(tmp_path / f"{name}.yaml")})
        with pytest.raises(CalibrationError):
            simulate(told, tmp_path / "refused", with_camera=True)
        assert not (tmp_path / "refused").exists()


@pytest.mark.slow
def test_the_model_is_written_whole_and_reads_back(bag: Path, tmp_path: Path) -> None:
    found = identification_of_bags(bag, options=FitOptions(n_modes=2))
    document = json.loads(write_models(found, tmp_path / "model.json").read_text())
    model = ModalModel.from_dict(document["model"])
    assert model.frequencies_hz == pytest.approx(
        [m["frequency_hz"] for m in found.content["modes"]], rel=1e-15
    )
    assert [p.name for p in tmp_path.iterdir()] == ["model.json"]
    assert "4.38" in format_table(found.content)


@pytest.mark.slow
def test_a_model_is_scored_on_data_that_it_has_not_seen(rig: Rig, bag: Path, tmp_path: Path) -> None:
    simulate(rig.with_values({"simulation.seed": 5}), tmp_path / "unseen")
    result = identification_of_bags(bag, validation=tmp_path / "unseen").content
    for name, score in result["validation"][0]["scores"].items():
        fitted = result["scores"][name]["fit_percent"]
        assert score["fit_percent"] == pytest.approx(fitted, abs=0.1)
        assert score["residual_over_noise"] == pytest.approx(1.0, abs=0.1)
        assert "prediction" in score["verdict"]


def test_the_hubs_device_clock_is_put_on_the_hosts_by_one_line(bag: Path) -> None:
    experiment = load_experiment(bag)
    times = experiment.record.inputs[0].times_s
    assert np.diff(times) == pytest.approx(1e-3, rel=1e-6)
    assert experiment.clock_rate.sd == 5e-5  # of the camera's clock: hub and host are one process
    told = Rig.from_file().with_values({"camera.clock_tolerance": 0.0})
    assert load_experiment(bag, told).clock_rate.sd == 0.0
    assert experiment.notes == ()


def without(bag: Path, path: Path, lost: dict[str, set[int]]) -> Path:
    """Copy a bag, but for some messages of some topics, by their numbers."""
    seen: dict[str, int] = {}
    with Bag(bag) as old, BagWriter(path) as new:
        for message in old.raw_messages():
            topic = message.topic.lstrip("/")
            number = seen[topic] = seen.get(topic, -1) + 1
            if number not in lost.get(topic, ()):
                new.write(topic, message.receive_ns, message.data)
    return path


LOST_AT_RANDOM = {topic: set(range(7 + k, 390, 9)) for k, topic in enumerate(("hub/measured", "hub/applied"))}
LOST_FRAMES = {"beam/displacement": set(range(5, 790, 7)) | set(range(400, 420))}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lost", "told"),
    [
        ({"hub/measured": {200}, "hub/applied": {200}}, "1 gap, 20 samples lost: at 3."),
        ({"hub/measured": set(range(150, 200))}, "1 gap, 1000 samples lost"),
        (LOST_AT_RANDOM, "43 gaps"),
        (LOST_FRAMES, "frames, at the longest"),
    ],
    ids=["one message of both kinds", "a second of telemetry", "every ninth message", "frames"],
)
def test_what_a_bag_lost_is_named_and_leaves_the_poles_where_they_are(
    bag: Path, tmp_path: Path, lost: dict[str, set[int]], told: str
) -> None:
    whole = identification_of_bags(bag).content
    result = identification_of_bags(without(bag, tmp_path / "damaged", lost)).content
    assert any(told in note for note in result["notes"])
    assert len(result["modes"]) == len(whole["modes"])
    for found, mode in zip(result["modes"], whole["modes"], strict=True):
        for name in ("frequency", "damping_ratio"):
            key, sd = (f"{name}_hz", f"{name}_sd_hz") if name == "frequency" else (name, f"{name}_sd")
            assert abs(found[key] - mode[key]) < mode[sd]


@pytest.mark.slow
def test_both_sides_of_a_restart_of_the_device_are_used_though_each_has_its_own_ticks_and_zero(
    bag: Path, tmp_path: Path
) -> None:
    border = 0
    with Bag(bag) as old, BagWriter(tmp_path / "restarted") as new:
        for message in old.raw_messages():
            topic, data = message.topic.lstrip("/"), message.data
            if topic.startswith("hub/") and topic != "hub/sequence_state" and topic != "hub/clock_sync":
                batch = decode_batch(data)
                border = border or batch.stamp_ns + 4_000_000_000
                if border <= batch.stamp_ns < border + 100_000_000:
                    continue  # while it starts
                if batch.stamp_ns > border:
                    zero = None if batch.positions is None else batch.positions - 0.005
                    data = encode_batch(replace(batch, epoch=batch.epoch + 1, positions=zero))
            new.write(topic, message.receive_ns, data)
    whole, result = (identification_of_bags(path).content for path in (bag, tmp_path / "restarted"))
    assert any("2 stretches" in note and "restarted 1 times" in note for note in result["notes"])
    for found, mode in zip(result["modes"], whole["modes"], strict=True):
        assert abs(found["frequency_hz"] - mode["frequency_hz"]) < mode["frequency_sd_hz"]
        # Without either side it is known half as well at best.
        assert found["frequency_sd_hz"] < 2.0 * mode["frequency_sd_hz"]


def test_frames_without_a_hub_are_named_and_a_hub_without_samples_is_refused(
    bag: Path, tmp_path: Path
) -> None:
    half = {topic: set(range(200, 1000)) for topic in ("hub/measured", "hub/applied")}
    notes = load_experiment(without(bag, tmp_path / "half", half)).notes
    assert any("nothing is known of the input hub, and are not used" in note for note in notes)
    one = {topic: set(range(1000)) - {150} for topic in ("hub/measured", "hub/applied")}
    with pytest.raises(BagError, match=r"known for 0.019 s only"):
        load_experiment(without(bag, tmp_path / "one", one))


@pytest.mark.slow
def test_a_mode_that_is_not_there_has_no_digits(bag: Path) -> None:
    result = identification_of_bags(bag, options=FitOptions(n_modes=3)).content
    (line,) = [line for line in format_table(result).splitlines() if "not a mode" in line]
    assert "does not stand out" in line
    assert "+-" not in line
    ours = dict(result["modes"][0], frequency_z=3.1e6, doubt="")
    assert ">999" in format_table({"modes": [ours]})


@pytest.mark.slow
def test_a_force_driven_hub_shows_the_free_hubs_poles(tmp_path: Path) -> None:
    rig = Rig.from_file().with_values({**SHORT, "hub.command_mode": "effort", "excitation.acceleration": 0.2})
    simulate(rig, tmp_path / "force")
    result = identification_of_bags(tmp_path / "force").content
    truth = rig.beam_model().free_hub_natural_frequencies / (2 * math.pi)
    assert result["structure"] == "force"
    for mode in result["modes"]:
        assert mode["frequency_hz"] == pytest.approx(truth[mode["theory_mode"] - 1], rel=3e-3)


def test_nothing_half_written_is_left_behind(rig: Rig, bag: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError):
        simulate(rig.with_values({"excitation.acceleration": 9.0}), tmp_path / "refused")
    with pytest.raises(BagExistsError):
        simulate(rig, bag)
    assert list(tmp_path.iterdir()) == []


def test_a_bag_without_the_needed_topics_is_refused_with_what_is_there(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "poor") as writer:
        writer.add_topic("hub/state")
    with pytest.raises(MissingTopicsError, match="beam/displacement"):
        identification_of_bags(tmp_path / "poor")
    with pytest.raises(BagError):
        identification_of_bags(tmp_path / "nowhere")


@pytest.mark.slow
def test_a_realistic_beam_loses_energy_to_the_air_and_the_linear_fit_says_that_it_is_not_enough(
    rig: Rig, tmp_path: Path
) -> None:
    air = {"simulation.drag_coefficient": 2.0, "simulation.large_deflections": True}
    simulate(rig.with_values(air), tmp_path / "realistic")
    result = identification_of_bags(tmp_path / "realistic", options=FitOptions(n_modes=1)).content
    assert result["modes"][0]["damping_ratio"] > 0.0055
    assert any("not white" in warning for warning in result["warnings"])


@pytest.mark.slow
def test_what_friction_servo_clocks_and_camera_do_is_in_the_bag_and_the_model_is_still_the_beams(
    rig: Rig, tmp_path: Path
) -> None:
    realistic = {
        "simulation.preset": "realistic",
        "simulation.drag_coefficient": 0.0,
        "simulation.large_deflections": False,
    }
    simulate(rig.with_values(realistic), tmp_path / "realistic")
    with Bag(tmp_path / "realistic") as bag:
        measured, applied = bag.hub_samples("hub/measured"), bag.hub_samples("hub/applied")
        frames = bag.displacements().stamps_ns
    moving = np.abs(applied.accelerations) > 0.0
    # Friction lets the hub stick at its reversals: the servo's force is beyond what the mass alone would take.
    assert np.max(np.abs(measured.efforts[moving])) > 1.5
    still = measured.positions[-500:]
    assert np.std(still) == pytest.approx(np.hypot(2e-7, 1e-7 / np.sqrt(12)), rel=0.1)
    assert np.mean(np.diff(measured.stamps_ns)) == pytest.approx(1e6 / (1 + 35e-6), abs=1.0)
    gaps = np.diff(frames)
    assert np.median(gaps) == pytest.approx(10_000_000, abs=10_000)
    assert np.std(gaps[gaps < 15_000_000]) == pytest.approx(np.sqrt(2) * 5e4, rel=0.1)
    result = identification_of_bags(tmp_path / "realistic").content
    truth = rig.beam_model().natural_frequencies / (2 * math.pi)
    # Sticking and slipping excites mode 3 beyond the sweep's end, too; nothing else is found.
    assert len(result["modes"]) in (2, 3)
    for k, mode in enumerate(result["modes"]):
        assert mode["frequency_hz"] == pytest.approx(truth[k], rel=1e-3)
        # 20 ppm of the camera's clock were 80 standard deviations of mode 1, were that clock taken for the host's.
        assert abs(mode["frequency_hz"] - truth[k]) < 4.0 * mode["frequency_sd_hz"]
        assert mode["damping_ratio"] == pytest.approx(0.005, rel=0.1 if k < 2 else 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [2e-6, 2e-5])
def test_noise_of_an_encoder_beside_an_axis_that_goes_as_it_is_led_costs_no_mode(
    rig: Rig, tmp_path: Path, noise: float
) -> None:
    noisy = rig.with_values(
        {"simulation.encoder_noise": noise, "excitation.duration": 5.0, "simulation.seed": 0}
    )
    simulate(noisy, tmp_path / "noisy")
    experiment = load_experiment(tmp_path / "noisy")
    assert experiment.record.inputs[0].sigma == 0.0
    assert any(f"noise of {noise * 1e6:.0f} um" in note for note in experiment.notes)
    # Were the rounding of 0.1 um all that is stated, mode 2 would be ten standard deviations off at 2 um.
    found = identification_of_bags(tmp_path / "noisy").content
    assert len(found["modes"]) == 2
    assert found["modes"][1]["frequency_sd_hz"] < 1.2e-3  # 1.0e-3 without the encoder's noise
    for mode in found["modes"]:
        assert abs(mode["frequency_z"]) < 4
        assert abs(mode["damping_ratio_z"]) < 4


@pytest.mark.slow
def test_noise_of_an_encoder_is_in_the_intervals_where_the_hub_goes_otherwise_than_it_is_led(
    rig: Rig, tmp_path: Path
) -> None:
    noisy = rig.with_values(
        {"simulation.encoder_noise": 2e-6, "excitation.duration": 5.0, "simulation.seed": 0}
    )
    simulate(noisy, tmp_path / "noisy")
    # Commands of the first second were lost: nobody knows where they led to.
    with Bag(tmp_path / "noisy") as old, BagWriter(tmp_path / "unled") as new:
        number = 0
        for raw in old.raw_messages():
            number += raw.topic == "/hub/applied"
            if raw.topic != "/hub/applied" or not 40 <= number < 50:
                new.write(raw.topic.strip("/"), raw.receive_ns, raw.data)
    experiment = load_experiment(tmp_path / "unled")
    assert experiment.record.inputs[0].sigma == pytest.approx(2e-6, rel=0.1)
    for mode in identification_of_bags(tmp_path / "unled").content["modes"]:
        assert abs(mode["frequency_z"]) < 4
        assert abs(mode["damping_ratio_z"]) < 4


def test_a_bag_of_an_earlier_version_tells_its_rig_in_todays_words(rig: Rig, tmp_path: Path) -> None:
    tree = rig.to_nested()
    for name in PRESETS["ideal"]:
        del tree["simulation"][name]
    del tree["simulation"]["preset"]
    for was, coefficient in ((False, 0.0), (True, 2.0)):
        tree["simulation"]["realistic"] = was
        described = described_rig(tmp_path, {"rig": tree})
        assert described.simulation.drag_coefficient == coefficient
        assert described.simulation.large_deflections == was
