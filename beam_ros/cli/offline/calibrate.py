"""Pixels to metres, with their uncertainty: from recorded bags, or from a printed board; or the camera's noise.

From bags: the hub stops at twenty or more positions in both directions for a second or two each while beam/markers
is recorded; every rest is a point of a straight line per marker, and together they tell the angle between the image's
rows and the hub's travel. The reference is the hub's own encoder, or another
sensor on a JointState topic (--reference TOPIC:NAME --reference-sd M).

From a board: the first picture or video shows the board in the beam's plane and gives the scale; further ones, of
the board tilted in other places, give the lens. --board counts the inner corners of a checkerboard or, with
--pattern charuco, of a ChArUco board, which need not be in view as a whole; with --pattern aruco it counts markers.
`beam track --calibration` and tracker.calibration read the result.

The camera's noise: `beam calibrate camera-noise SERIES... [--dark SERIES]`, where each series is a video, a folder of
pictures or a bag that shows an even scene at rest, two or more of them in different light. --save writes a parameter
file for the tracker.
"""

from __future__ import annotations

import argparse
import math
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beam_ros.cli.options import add_rig_file, quiet_opencv, read_rig
from beam_ros.errors import UsageError
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json

if TYPE_CHECKING:
    from beam_ros.vision.calibration.procedure import CalibrationFit


_NOISE = "camera-noise"
_COLDEST, _HOTTEST = -60.0, 150.0  # [degrees Celsius] at which cameras work


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "sources", type=Path, nargs="+", metavar="SOURCE", help="bags, or with --board pictures and videos"
    )
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the calibration to this YAML file")
    parser.add_argument(
        "--reference",
        default="hub/measured",
        metavar="TOPIC[:NAME]",
        help="reference sensor in the bags (default: the hub's encoder, hub/measured)",
    )
    parser.add_argument(
        "--reference-sd",
        type=float,
        metavar="M",
        help="its standard deviation in m (default: hub.encoder_resolution over sqrt(12))",
    )
    parser.add_argument(
        "--frames",
        type=int,
        help="frames averaged at the end of each rest (default: tracker.averaged_frames)",
    )
    parser.add_argument(
        "--board",
        metavar="COLUMNSxROWS",
        help="inner corners of a board, as 8x6; of --pattern aruco: markers",
    )
    parser.add_argument(
        "--square", type=float, metavar="M", help="edge of its squares, or from marker to marker, in m"
    )
    parser.add_argument(
        "--square-sd", type=float, default=0.0, metavar="M", help="standard deviation of that edge in m"
    )
    parser.add_argument(
        "--pattern",
        choices=("checkerboard", "charuco", "aruco"),
        default="checkerboard",
        help="what is printed on the board (default: checkerboard)",
    )
    parser.add_argument("--marker", type=float, metavar="M", help="edge of the markers on the board in m")
    parser.add_argument(
        "--dictionary", metavar="NAME", help="of the markers on the board, as 5x5_100 or apriltag_36h11"
    )
    parser.add_argument(
        "--temperature", type=float, metavar="CELSIUS", help="in the room, kept with the calibration"
    )
    parser.add_argument(
        "--dark", type=Path, metavar="SERIES", help="with camera-noise: frames taken with the lens covered"
    )
    add_rig_file(parser)
    parser.add_argument("--json", action="store_true", help="print the calibration and its tests as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    quiet_opencv()
    circumstances: dict[str, Any] = {"date": datetime.now(timezone.utc).isoformat(timespec="seconds")}
    if arguments.temperature is not None:
        if not _COLDEST <= arguments.temperature <= _HOTTEST:
            raise UsageError(
                f"--temperature is {arguments.temperature:g}: expected degrees Celsius, from {_COLDEST:g} to "
                f"{_HOTTEST:g}"
            )
        circumstances["temperature_celsius"] = arguments.temperature
    if str(arguments.sources[0]) == _NOISE:
        result = _camera_noise(arguments, circumstances)
    elif arguments.dark is not None:
        raise UsageError(f"--dark goes with `beam calibrate {_NOISE} SERIES...`")
    else:
        result = (
            _from_board(arguments, circumstances) if arguments.board else _from_bags(arguments, circumstances)
        )
    if arguments.json:
        print(strict_json(result, indent=2))
    else:
        print("\n".join([*result["table"], *(f"note: {warning}" for warning in result["warnings"])]))
        if arguments.save is not None:
            print(f"saved    {arguments.save}")
    return 0


def _save(calibration: Any, path: Path | None) -> None:
    from beam_ros.vision.calibration.storage import save_calibration

    if path is not None:
        save_calibration(calibration, path)


def _from_bags(arguments: argparse.Namespace, circumstances: dict[str, Any]) -> dict[str, Any]:
    from beam_ros.calibration.from_bag import calibrate_from_bags
    from beam_ros.offline.video_into_bag import bag_rig

    for option in ("square", "marker", "dictionary"):
        if getattr(arguments, option) is not None:
            raise UsageError(f"--{option} goes with --board COLUMNSxROWS")
    if arguments.frames is not None and arguments.frames < 10:
        raise UsageError(f"--frames is {arguments.frames}: expected at least 10 for each rest")
    rig = None
    if arguments.rig_file is not None:
        rig = read_rig(arguments)
    elif arguments.parameters:
        rig = bag_rig(arguments.sources[0]).with_texts(arguments.parameters)
    with Progress("calibrate", 1.0) as stage:
        fit, rig = calibrate_from_bags(
            arguments.sources,
            rig=rig,
            reference=arguments.reference,
            reference_sd_m=arguments.reference_sd,
            frames=arguments.frames,
            circumstances=circumstances,
        )
        stage.finish(f"{fit.calibration.provenance['n_points']} positions")
    _save(fit.calibration, arguments.save)
    return {
        "calibration": fit.calibration.to_dict(),
        "markers": _tests(fit, rig.markers.names),
        "warnings": list(fit.warnings),
        "table": _table(fit, rig.markers.names),
    }


def _camera_noise(arguments: argparse.Namespace, circumstances: dict[str, Any]) -> dict[str, Any]:
    from beam_ros.calibration.from_flats import noise_from_flats, save_parameters

    sources = arguments.sources[1:]
    if not sources:
        raise UsageError(
            f"`beam calibrate {_NOISE}` needs series of frames: videos, folders of pictures, or bags"
        )
    for option in ("board", "square", "marker", "dictionary"):
        if getattr(arguments, option) is not None:
            raise UsageError(f"--{option} goes with pictures of a board, not with `beam calibrate {_NOISE}`")
    with Progress("calibrate", 1.0) as stage:
        noise = noise_from_flats(sources, arguments.dark)
        stage.finish(f"{sum(noise.n_frames)} frames")
    if arguments.save is not None:
        save_parameters(noise, arguments.save, circumstances)
    table = [
        f"variance     {noise.variance:.4g} +- {noise.variance_sd:.2g} grey levels^2 at level 0, and "
        f"{noise.per_grey:.4g} +- {noise.per_grey_sd:.2g} more for each grey level",
        f"gain         {noise.electrons_per_grey:.4g} +- {noise.electrons_per_grey_sd:.2g} electrons per grey level",
        "PRNU         "
        + (
            "not known"
            if noise.prnu is None or noise.prnu_sd is None
            else f"{100 * noise.prnu:.3g} +- {100 * noise.prnu_sd:.2g} %"
        ),
        f"linearity    the variance leaves the line by {100 * noise.curvature:+.2g} +- "
        f"{100 * noise.curvature_sd:.2g} % from level {noise.levels[0]:.1f} to {noise.levels[1]:.1f}",
    ]
    warnings = list(noise.warnings)
    if noise.bias is None:
        warnings.append(
            "without --dark, bias and read noise are not known, and the PRNU takes the bias for light"
        )
    else:
        table[1:1] = [
            f"bias         {noise.bias:.4g} +- {noise.bias_sd:.2g} grey levels",
            f"read noise   {noise.read_noise:.4g} +- {noise.read_noise_sd:.2g} grey levels",
        ]
    if not noise.is_straight:
        warnings.append(
            "the variance does not follow the light: set gamma to 1, switch off automatic gain and denoising"
        )
    return {"camera_noise": noise.to_dict(), "warnings": warnings, "table": table}


def _tests(fit: CalibrationFit, names: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    return {
        name: {
            "pixels_per_metre": abs(line.slope),
            "pixels_per_metre_sd": math.sqrt(line.covariance[0, 0]),
            "zero_px": line.intercept,
            "zero_sd_px": math.sqrt(line.covariance[1, 1]),
            "residual_rms_px": line.residual_rms_px,
            "reduced_chi_squared": line.chi_squared / line.degrees_of_freedom,
            "hysteresis_px": line.hysteresis_px,
            "hysteresis_sd_px": line.hysteresis_sd_px,
            "curvature_px_m2": line.curvature,
            "curvature_sd_px_m2": line.curvature_sd,
            "has_hysteresis": line.has_hysteresis,
            "is_curved": line.is_curved,
        }
        for name, line in zip(names, fit.lines, strict=True)
    }


def _table(fit: CalibrationFit, names: tuple[str, ...]) -> list[str]:
    calibration = fit.calibration
    lines = [
        f"travel    at {calibration.angle * 1e3:+.3f} +- {calibration.angle_sd * 1e3:.2g} mrad to the image's rows",
        "marker          scale [px/m]             zero [px]       residual   hysteresis [px]      curvature "
        "[px/m^2]   chi^2/dof",
    ]
    for name, line in zip(names, fit.lines, strict=True):
        scale_sd, zero_sd = (math.sqrt(line.covariance[k, k]) for k in (0, 1))
        lines.append(
            f"{name:<10} {abs(line.slope):>10.3f} +- {scale_sd:<8.2g} {line.intercept:>10.4f} +- {zero_sd:<8.2g} "
            f"{line.residual_rms_px:>7.4f} px {line.hysteresis_px:>+8.4f} +- {line.hysteresis_sd_px:<8.2g}"
            f"{line.curvature:>+9.2f} +- {line.curvature_sd:<8.2g} "
            f"{line.chi_squared / line.degrees_of_freedom:>7.2f}"
        )
    return lines


def _from_board(arguments: argparse.Namespace, circumstances: dict[str, Any]) -> dict[str, Any]:
    from beam_ros.calibration.from_board import calibrate_from_board
    from beam_ros.vision.calibration.board_fits import COEFFICIENTS
    from beam_ros.vision.calibration.boards import Board

    columns, separator, rows = arguments.board.lower().partition("x")
    if not (separator and columns.isdigit() and rows.isdigit()):
        raise UsageError(
            f"--board is {arguments.board!r}: expected its inner corners, or markers of --pattern aruco, as 8x6"
        )
    if arguments.square is None:
        raise UsageError("--board needs --square, the edge of its squares in m")
    if arguments.pattern == "checkerboard" and (
        arguments.marker is not None or arguments.dictionary is not None
    ):
        raise UsageError("--marker and --dictionary go with --pattern charuco or aruco")
    board = Board(
        int(columns),
        int(rows),
        arguments.square,
        arguments.square_sd,
        arguments.pattern,
        arguments.marker or 0.0,
        arguments.dictionary or "",
    )
    plane, *tilted = arguments.sources
    with Progress("calibrate", 1.0) as stage:
        found = calibrate_from_board(plane, tilted, board, read_rig(arguments), circumstances)
        stage.finish(f"board found in {plane}")
    _save(found.calibration, arguments.save)
    table = [
        f"scale    {found.scale.pixels_per_metre:.3f} +- {found.scale.sd:.2g} px/m, corners off by "
        f"{found.scale.residual_rms_px:.3f} px (RMS), scale over the board even to {100 * found.scale.tilt:.2f} %"
    ]
    if found.lens is not None:
        fit, lens = found.lens, found.lens.lens
        bends = [
            f"{name} {value:+.4f} +- {sd:.2g}"
            for name, value, sd in zip(COEFFICIENTS, lens.distortion, fit.distortion_sd, strict=True)
            if name in fit.coefficients
        ]
        table.append(
            f"lens     {fit.n_pictures} pictures, corners off by {fit.residual_rms_px:.3f} px (RMS), "
            f"focal length {lens.focal_px[0]:.1f} +- {fit.focal_sd_px[0]:.2g} px, distortion "
            + (", ".join(bends) or "none that the pictures show")
        )
    return {
        "calibration": found.calibration.to_dict(),
        "scale_sd": found.scale.sd,
        "tilt": found.scale.tilt,
        "residual_rms_px": found.scale.residual_rms_px,
        "warnings": list(found.warnings),
        "table": table,
    }
