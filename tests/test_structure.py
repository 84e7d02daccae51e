"""The tests of every module are found, in the mirrored tree or by a row of a table; no name is used twice."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("beam_model", "beam_ident", "beam_ros")

TESTED_IN = (
    ("beam_ident/modal", "mode_change", "modal_identification/test_change_moves"),
    ("beam_ident/modal_identification", "mode_changes", "modal_identification/test_change_moves"),
    # room, modules, file of their tests (from the tests of the room's package)
    ("beam_model", "errors", "test_parameters"),
    ("beam_model", "frequency_response", "galerkin/test_model"),
    ("beam_model/galerkin", "matrices", "galerkin/test_model"),
    ("beam_model/galerkin", "compiled", "galerkin/test_stepping"),
    ("beam_ident", "record_estimators", "test_estimators"),
    ("beam_ident", "results summary", "test_result_members"),
    (
        "beam_ident/axis",
        "axis_output_error axis_result inverse_dynamics",
        "axis/test_axis_estimation",
    ),
    ("beam_ident/best_linear", "realisations result", "best_linear/test_approximation"),
    ("beam_ident/data", "prior", "modal_identification/test_time_domain"),
    ("beam_ident/data", "stored_form", "test_stored_results"),
    ("beam_ident/design", "summary", "design/test_prediction"),
    ("beam_ident/design", "criteria", "design/test_spectrum"),
    ("beam_ident/design", "standard", "design/test_experiment"),
    ("beam_ident/evaluation", "model_comparison", "modal_identification/test_time_domain"),
    ("beam_ident/excitation", "moves sampled sines sweeps windows", "excitation/test_motions"),
    ("beam_ident/excitation", "crest_optimisation noise seeds", "excitation/test_multisine"),
    ("beam_ident/figures", "canvas excitation poles responses validation", "figures/test_figures"),
    ("beam_ident/figures", "amplitude identification modes", "report/test_identification"),
    ("beam_ident/modal", "block_rows fit", "modal/test_model"),
    ("beam_ident/modal", "line_basis", "modal_estimation/test_frequency_domain"),
    ("beam_ident/modal", "free_decay_result", "modal_estimation/test_free_decay"),
    ("beam_ident/modal", "stacked_regression", "modal_estimation/test_variable_projection"),
    ("beam_ident/modal", "identification_result mode_values", "test_result_members"),
    ("beam_ident/modal", "regression", "modal_identification/test_time_domain"),
    ("beam_ident/modal", "structure", "modal/test_realisation"),
    ("beam_ident/modal_estimation", "record_levels", "modal_identification/test_several_records"),
    (
        "beam_ident/modal_identification",
        "estimation fit_tests time_result",
        "modal_identification/test_time_domain",
    ),
    (
        "beam_ident/modal_identification",
        "clock_moves signal_clocks",
        "modal_identification/test_output_delays",
    ),
    ("beam_ident/modal_identification", "conditions", "modal_identification/test_time_search"),
    ("beam_ident/modal_identification", "clock_jump_moves", "data/test_stamp_jumps"),
    ("beam_ident/modal_identification", "noise_moves", "modal_identification/test_unseen_noise"),
    ("beam_ident/noise", "line_weights", "transfer_function_estimation/test_frequency_domain"),
    ("beam_ident/noise", "record_fit", "modal_identification/test_several_records"),
    ("beam_ident/numerics", "chain_response", "numerics/test_rational_response"),
    ("beam_ident/report", "equation evidence measurement validation", "report/test_identification"),
    ("beam_ident/responses", "periods", "responses/test_periodic_averaging"),
    ("beam_ident/responses", "signal_pair", "responses/test_spectral"),
    ("beam_ident/shaping", "known_beam", "shaping/test_residual"),
    ("beam_ident/subspace", "po_moesp", "subspace/test_model"),
    ("beam_ident/transfer_function", "multi_input_model", "transfer_function_estimation/test_multi_input"),
    ("beam_ident/transfer_function", "output_prediction", "transfer_function/test_model"),
    (
        "beam_ident/transfer_function_estimation",
        "additive_fit",
        "transfer_function_estimation/test_multi_input",
    ),
    ("beam_ident/transfer_function_estimation", "delay_search", "transfer_function_estimation/test_delay"),
    (
        "beam_ident/transfer_function_estimation",
        "record_share srivc state_variable_filter",
        "transfer_function_estimation/test_estimation",
    ),
    ("beam_ros", "errors", "cli/test_main"),
    ("beam_ros/bags", "metadata recording_mark", "offline/test_recovery"),
    ("beam_ros/bags", "summary", "bags/test_reading"),
    ("beam_ros/bags", "stamped_rows", "offline/test_export"),
    ("beam_ros/checks", "excitation_gates signal_gates stamp_gates", "checks/test_bag_check"),
    ("beam_ros/cli", "options", "cli/test_main"),
    ("beam_ros/cli/live", "call up", "launching/test_up"),
    ("beam_ros/launching", "guards", "launching/test_up"),
    ("beam_ros/cli/live", "view", "launching/test_live_view"),
    ("beam_ros/cli/live", "demo record replay run", "cli/test_main"),
    ("beam_ros/cli/live", "experiment", "experiments/test_conduct"),
    ("beam_ros/cli/live", "thesis", "thesis/test_document"),
    ("beam_ros/thesis", "data figures tables", "thesis/test_document"),
    ("beam_ros/experiments", "outcome steps", "experiments/test_conduct"),
    ("beam_ros/cli/offline", "export model recover simulate", "cli/test_main"),
    ("beam_ros/cli/offline", "import_", "offline/test_column_import"),
    ("beam_ros/cli/results", "compare", "reporting/test_comparison"),
    ("beam_ros/cli/results", "check", "checks/test_bag_check"),
    ("beam_ros/cli/offline", "design", "excitation/test_plan"),
    ("beam_ros/cli/offline", "shape", "reporting/test_shaping"),
    ("beam_ros/reporting", "move_figures", "reporting/test_shaping"),
    ("beam_ros/offline", "axis_following swing_after", "reporting/test_shaping"),
    ("beam_ros/cli/offline", "track", "offline/test_video_into_bag"),
    ("beam_ros/excitation", "recipes", "excitation/test_plan"),
    ("beam_ros/files", "array_files tdms_files universal_files", "files/test_formats"),
    ("beam_ros/hub", "answers contract host_clock journal ticks", "hub/simulated/test_simulated_hub"),
    ("beam_ros/hub/host", "pulse sequence_stream", "hub/line/test_client"),
    (
        "beam_ros/hub/host",
        "axis_watch hold_watch rest_watch stop_promise tick_watch",
        "hub/host/test_promises",
    ),
    ("beam_ros/hub/host", "led_watch", "hub/links/test_host_axis"),
    ("beam_ros/hub/host", "missing_messages", "hub/host/test_supervisor"),
    ("beam_ros/hub/host", "waking_time", "hub/host/test_contact"),
    ("beam_ros/hub/gate", "stamps", "hub/gate/test_command_gate"),
    (
        "beam_ros/hub/conformance",
        "bench_checks check dialogue kinematics limit_checks line_checks misfits motion_checks motions playing "
        "sequence_checks session_checks state_checks",
        "hub/conformance/test_suite",
    ),
    ("beam_ros/hub/firmware", "built_firmware", "hub/firmware/test_stm32f405"),
    ("beam_ros/hub", "link_parameters", "hub/links/test_odrive"),
    ("beam_ros/hub/line", "greeting watchdog_proof", "hub/line/test_connection"),
    ("beam_ros/hub", "errors", "hub/line/test_driver"),
    ("beam_ros/cli/offline", "axis", "hub/links/test_probe"),
    ("beam_ros/hub/emulated", "line_board", "hub/links/test_csv_board"),
    ("beam_ros/hub/emulated", "lies", "hub/test_axis_safety"),
    ("beam_ros/hub/emulated", "pseudo_terminal", "hub/emulated/test_controller"),
    ("beam_ros/hub/links", "course place", "hub/links/test_host_axis"),
    ("beam_ros/hub/simulated", "drifting_clock", "hub/simulated/test_simulated_hub"),
    ("beam_ros/hub/emulated", "odrive servo", "hub/links/test_odrive"),
    ("beam_ros/hub/links", "polled_hub query_line", "hub/links/test_dynamixel"),
    ("beam_ros/hub/emulated", "trajectory_controller", "hub/links/test_trajectory"),
    ("beam_ros/hub/simulated", "beam_points", "rig/test_filming"),
    ("beam_ros/hub/simulated", "motion encoder limits sequence_buffer", "hub/simulated/test_axis"),
    ("beam_ros/interfaces", "parameter", "interfaces/test_rig_parameters"),
    ("beam_ros/launching", "processes", "launching/test_demo"),
    (
        "beam_ros/messages",
        "batches camera clocks commands health joint_states markers message_types stamps texts trajectories",
        "messages/test_messages",
    ),
    ("beam_ros/nodes", "bag_player", "bags/test_bag_player"),
    ("beam_ros/nodes", "bag_recorder", "bags/test_bag_recorder"),
    ("beam_ros/nodes", "simulator", "nodes/test_contract"),
    ("beam_ros/nodes", "identifier", "launching/test_demo"),
    ("beam_ros/offline", "estimate_process", "nodes/test_live_identifier"),
    (
        "beam_ros/model_files",
        "filter_chain mat modelica ro_crate shapers universal",
        "model_files/test_formats",
    ),
    ("beam_ros/offline", "tracked_film", "offline/test_video_into_bag"),
    ("beam_ros/rig", "film_points", "offline/test_film_rendering"),
    ("beam_ros/calibration", "pictures", "calibration/test_from_flats"),
    ("beam_ros/cli/offline", "render", "offline/test_film_rendering"),
    ("beam_ros/vision/rendering", "imaging", "offline/test_film_rendering"),
    ("beam_ros/offline", "identification identification_summary", "offline/test_simulation"),
    ("beam_ros/offline/loading", "described_rig experiment hub_drive markers", "offline/test_simulation"),
    ("beam_ros/offline/loading", "seen_data", "offline/test_foreign_bags"),
    ("beam_ros/process", "executables folders progress", "cli/test_main"),
    ("beam_ros/process", "interruption", "nodes/test_endings"),
    ("beam_ros/reporting", "provenance", "reporting/test_identification"),
    ("beam_ros/offline", "theory", "reporting/test_identification"),
    ("beam_ros/shell", "axis_emulators axis_links trajectory_topics", "nodes/test_axis_links"),
    ("beam_ros/shell", "fault_requests", "nodes/test_firmware_emulator"),
    ("beam_ros/shell", "frame_averaging frame_sources", "nodes/test_vision_tracker"),
    ("beam_ros/cli/results", "study", "studies/test_study"),
    ("beam_ros/studies", "rows statistics summary table", "studies/test_study"),
    ("beam_ros/viewers", "curves foxglove plotjuggler ros_tools", "viewers/test_layouts"),
    ("beam_ros/vision/camera", "source", "vision/camera/test_capture"),
    ("beam_ros/vision/calibration", "procedure", "vision/calibration/test_linear"),
    ("beam_ros/vision/calibration", "lens_covariance", "vision/calibration/test_board_fits"),
    ("beam_ros/vision/calibration", "perspective", "offline/test_whole_beam"),
    ("beam_ros/vision/strip", "cross_section noise prediction search", "vision/strip/test_following"),
    ("beam_ros/vision/rendering", "disturbances", "vision/tracking/test_tracker"),
    (
        "beam_ros/vision/tracking",
        "acquisition recovery spot_search",
        "vision/tracking/test_tracker",
    ),
)
"""Modules without a file of tests of their own name, and where they are tested."""


def own_tests(module: Path) -> Path:
    """Where the mirrored tree has the tests of a module."""
    return ROOT / "tests" / module.parent / f"test_{module.name}.py"


def has_function(path: Path) -> bool:
    """Whether a module does anything: names and types alone need no tests."""
    return re.search(r"^ *(?:async )?def ", path.read_text(), re.M) is not None


@cache
def modules() -> set[Path]:
    """All modules of the three packages, from the tree's root and without suffix."""
    paths = [
        path for package in PACKAGES for path in (ROOT / package).rglob("*.py") if path.stem != "__init__"
    ]
    return {path.relative_to(ROOT).with_suffix("") for path in paths if has_function(path)}


def in_table() -> dict[Path, Path]:
    """From a module of the table to its tests."""
    return {
        Path(room) / name: ROOT / "tests" / Path(room).parts[0] / f"{file}.py"
        for room, names, file in TESTED_IN
        for name in names.split()
    }


def test_every_module_has_tests_beside_it_or_a_row_in_the_table() -> None:
    mirrored = {module for module in modules() if own_tests(module).exists()}
    missing = sorted(map(str, modules() - mirrored - set(in_table())))
    assert not missing, f"write tests/<package>/<room>/test_<module>.py, or add a row to {__name__}.TESTED_IN"


def test_the_table_names_no_module_twice_and_none_that_is_gone_or_has_tests_of_its_own() -> None:
    listed = [Path(room) / name for room, names, _ in TESTED_IN for name in names.split()]
    assert sorted(listed) == sorted(set(listed))
    assert [str(module) for module in listed if module not in modules() or own_tests(module).exists()] == []


def test_the_tables_files_of_tests_exist() -> None:
    assert [str(file) for file in set(in_table().values()) if not file.exists()] == []


def test_no_two_public_classes_share_a_name() -> None:
    homes: dict[str, list[str]] = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for name in re.findall(r"^class ([A-Za-z]\w*)", path.read_text(), re.M):
                homes.setdefault(name, []).append(str(path.relative_to(ROOT)))
    assert {name: paths for name, paths in homes.items() if len(paths) > 1} == {}
