"""The recordings of `bags/` hold what their truth says, and their script makes them."""

from __future__ import annotations

import importlib.util
import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from beam_ident import fit_free_decay
from beam_ros.bags.reading import Bag
from beam_ros.messages import BagTypes
from beam_ros.offline.identification import identification_of_bags
from beam_ros.offline.loading.described_rig import described_rig
from beam_ros.offline.loading.experiment import load_experiment
from beam_ros.rig.rig import Rig
from tests.whole_bags import messages_of_whole_bag

FOLDER = Path(__file__).parent.parent / "bags"
EXPECTED: dict[str, dict[str, Any]] = json.loads((FOLDER / "expected.json").read_text(encoding="utf-8"))
RECORDINGS = sorted(EXPECTED)


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_bags", FOLDER / "make_bags.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_recording_is_expected_described_and_made_by_the_script(script: ModuleType) -> None:
    there = {path.parent.name for path in FOLDER.glob("*/metadata.yaml")}
    page = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert set(script.RECORDINGS) == set(EXPECTED) == there
    assert [name for name in RECORDINGS if f"| `{name}` |" not in page] == []
    size = sum(path.stat().st_size for path in FOLDER.rglob("*") if path.is_file())
    assert size < 9e6, "the recordings are there to be small"


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_a_recording_identifies_as_its_truth_and_as_expected(name: str) -> None:
    truth, expected = EXPECTED[name]["truth"], EXPECTED[name]["identified"]
    result = identification_of_bags(FOLDER / name).content
    assert result["converged"]
    assert len(result["modes"]) == len(expected["modes"]) >= 2
    for k, (mode, stated) in enumerate(zip(result["modes"], expected["modes"], strict=True)):
        omega, zeta = truth["natural_frequencies"][k], truth["damping_ratios"][k]
        assert mode["theory_mode"] == k + 1
        assert abs(mode["frequency_hz"] - omega / (2 * np.pi)) < 4 * mode["frequency_sd_hz"]
        assert abs(mode["damping_ratio"] - zeta) < 4 * mode["damping_ratio_sd"]
        for value, sd in (("frequency_hz", "frequency_sd_hz"), ("damping_ratio", "damping_ratio_sd")):
            # Other versions of SciPy end their iterations elsewhere, by far less than the statistics.
            assert abs(mode[value] - stated[value]) < 0.2 * stated[sd]
            assert mode[sd] == pytest.approx(stated[sd], rel=0.1)
    fits = {output: score["fit_percent"] for output, score in result["scores"].items()}
    assert fits == pytest.approx(expected["fit_percent"], abs=0.05)


@pytest.mark.parametrize("name", RECORDINGS)
def test_both_libraries_find_a_recording_whole_and_read_the_same(name: str) -> None:
    assert messages_of_whole_bag(FOLDER / name)


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDINGS)
def test_the_script_makes_a_recording_anew(script: ModuleType, name: str, tmp_path: Path) -> None:
    script.record(name, tmp_path / name)
    with Bag(FOLDER / name) as kept, Bag(tmp_path / name) as made:
        positions = [bag.displacements().positions for bag in (kept, made)]
        infos = [bag.excitation_info() or {} for bag in (kept, made)]
    assert infos[0]["recipe"] == infos[1]["recipe"]
    # A parameter that the rig has got since then has its default in both.
    assert described_rig(FOLDER / name, infos[0]) == described_rig(tmp_path / name, infos[1])
    # Other versions of NumPy and SciPy round differently: far below the 5 um of noise.
    np.testing.assert_allclose(positions[0], positions[1], atol=1e-9)


@pytest.mark.slow
def test_a_recording_is_the_same_to_the_last_byte_each_time(script: ModuleType, tmp_path: Path) -> None:
    name = "drifting"
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        script.record(name, tmp_path / folder / name)
    for file in (f"{name}_0.mcap", "metadata.yaml"):
        one, other = (tmp_path / folder / name / file for folder in ("one", "other"))
        assert one.read_bytes() == other.read_bytes()


def test_the_decay_tells_the_same_poles_without_any_input() -> None:
    record = load_experiment(FOLDER / "decay").record
    moving = np.flatnonzero(np.diff(record.inputs[0].values))
    rest_s = float(record.inputs[0].times_s[moving[-1] + 1])
    decay = fit_free_decay(list(record.outputs), n_modes=2, start_s=rest_s + 0.01)
    truth = EXPECTED["decay"]["truth"]
    omegas, zetas = np.array(truth["natural_frequencies"][:2]), np.array(truth["damping_ratios"][:2])
    assert np.all(np.abs(decay.natural_frequencies - omegas) < 4 * decay.natural_frequency_sd)
    assert np.all(np.abs(decay.damping_ratios - zetas) < 4 * decay.damping_ratio_sd)


def test_the_drifting_one_has_all_that_is_said_of_it() -> None:
    with Bag(FOLDER / "drifting") as bag:
        table, hub = bag.displacements(), bag.hub_samples("hub/measured")
    steps = np.diff(table.stamps_ns)
    dropped = steps > 15_000_000
    assert 0.01 < np.count_nonzero(dropped) / len(steps) < 0.03
    assert np.std(steps[~dropped]) == pytest.approx(np.sqrt(2) * 2e5, rel=0.1)
    # The live map begins with no rate and learns it within the first second.
    assert np.mean(np.diff(hub.stamps_ns)) == pytest.approx(1e6 / (1 + 400e-6), abs=3.0)
    assert dict(zip(table.names, np.sum(np.isnan(table.positions), axis=0), strict=True)) == {
        "z010": 20,
        "z225": 40,
        "z285": 31,
    }


@pytest.mark.verify
def test_the_page_on_clocks_says_what_counting_and_stamping_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(FOLDER.parent)
    names: dict[str, Any] = {}
    page = Path("docs/clocks.md").read_text(encoding="utf-8")
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], names)  # type: ignore[index]
    omega = EXPECTED["drifting"]["truth"]["natural_frequencies"][0]
    off, fit = {}, {}
    for way in ("counted", "stamped", "mapped"):
        omegas, _, omega_sd, _ = names[way].model.modes()
        off[way] = float((omegas[0] - omega) / omega_sd[0])
        fit[way] = float(names[way].scores[-1].fit_percent)
    # As the page's table says; other versions of SciPy end their iterations elsewhere.
    assert off == pytest.approx({"counted": -10.8, "stamped": 15.5, "mapped": 0.8}, abs=1.0)
    assert fit == pytest.approx({"counted": 85.48, "stamped": 99.44, "mapped": 99.49}, abs=0.1)
    assert names["stamped"].warnings
    assert not names["mapped"].warnings


def test_the_frames_of_the_filmed_one_give_its_displacements() -> None:
    pytest.importorskip("cv2")
    from beam_ros.vision.calibration.linear import LinearCalibration
    from beam_ros.vision.measurement.measuring_chain import MeasuringChain

    types = BagTypes()
    with Bag(FOLDER / "frames") as bag:
        rig = Rig.from_nested((bag.excitation_info() or {})["rig"])
        camera = rig.camera_parameters()
        calibration = LinearCalibration.from_camera(camera, len(rig.markers.names))
        chain = MeasuringChain(camera, rig.tracker_parameters(), rig.markers.heights, calibration)
        found = []
        for raw in bag.raw_messages("camera/image_raw"):
            message = types.deserialize(raw.data, "sensor_msgs/msg/Image")
            stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            frame = np.frombuffer(message.data, np.uint8).reshape(message.height, message.width)
            found.append(chain.measure(stamp_ns, frame).displacement.x_m)
        # To a nanometre, a thousandth of what a marker is known by: by less the tracker may change.
        assert np.array(found) == pytest.approx(bag.displacements().positions, abs=1e-9)
        assert bag.count("camera/camera_info") == len(found) > 200
