"""Track the markers through a video, or the whole strip, and put the displacements into the bag of its experiment.

For a camera that only leaves a file. With --points full the strip itself is followed at every tenth row: a beam on
which nothing is glued. The bag holds what the hub measured; the lowest marker, which moves as the hub
does, tells when the video was taken and how fast its clock ran. The bag then identifies like any other. Its old form
stays beside it as BAG_untracked, unless --out names a new bag. Without a bag, --csv writes a table of the points by
the film's own time. --explain draws what was seen in a frame in which markers are missing, and why it was not taken.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from beam_ros.cli.options import add_rig_file, quiet_opencv, read_rig
from beam_ros.errors import UsageError
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument("video", type=Path, metavar="VIDEO", help="file that OpenCV can read")
    result = parser.add_mutually_exclusive_group(required=True)
    result.add_argument(
        "--into", type=Path, metavar="BAG", help="folder of the bag of the same experiment, with hub/measured"
    )
    result.add_argument(
        "--csv",
        type=Path,
        metavar="FILE",
        help="write a table of time, place and standard deviation; needs no bag",
    )
    parser.add_argument(
        "--explain",
        type=Path,
        metavar="PICTURE",
        help="draw the frame with the fewest valid markers: what was seen in it, and why it was not taken",
    )
    parser.add_argument(
        "--out", type=Path, metavar="BAG", help="write this new bag and leave --into as it is"
    )
    parser.add_argument(
        "--points",
        choices=("markers", "full"),
        default="markers",
        help="follow the markers, or the whole strip by its edges (default: markers)",
    )
    parser.add_argument(
        "--row-step", type=int, default=10, metavar="N", help="rows of a point of the strip (default: 10)"
    )
    time = parser.add_mutually_exclusive_group()
    time.add_argument(
        "--rate", type=float, metavar="HZ", help="frames per second (default: as the file says)"
    )
    time.add_argument("--times", type=Path, metavar="FILE", help="time of every frame in seconds, one a line")
    parser.add_argument(
        "--exact-rate",
        action="store_true",
        help="the frame times run as the hub's do: fit the offset alone, not the rate of the camera's clock",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE",
        help="pixels to metres (default: the rig's tracker.calibration, else camera.pixels_per_metre)",
    )
    parser.add_argument(
        "--replace", action="store_true", help="leave out displacements that the bag has already"
    )
    add_rig_file(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    quiet_opencv(keeps_decoders=True)
    from beam_ros.offline.film_table import FrameExplanation, film_into_table
    from beam_ros.offline.video_into_bag import bag_rig, track_into_bag
    from beam_ros.rig.rig import Rig
    from beam_ros.vision.calibration.storage import load_calibration

    calibration = None if arguments.calibration is None else load_calibration(arguments.calibration)
    rig: Rig | None = None
    if arguments.rig_file is not None or arguments.csv is not None:
        rig = read_rig(arguments)
    elif arguments.parameters:
        rig = bag_rig(arguments.into).with_texts(arguments.parameters)
    explanation = None
    if arguments.explain is not None:
        if arguments.points == "full":
            raise UsageError("--explain draws markers: expected it without --points full")
        explanation = FrameExplanation(rig or bag_rig(arguments.into))
    film = {
        "rate_hz": arguments.rate,
        "times_path": arguments.times,
        "calibration": calibration,
        "is_whole": arguments.points == "full",
        "row_step": arguments.row_step,
        "watch": None if explanation is None else explanation.look,
    }
    with Progress("track", 1.0) as stage:
        film["progress"] = lambda phrase, share: stage.update(share, phrase)
        try:
            if rig is not None and arguments.csv is not None:
                result = film_into_table(arguments.video, arguments.csv, rig, **film)
                stage.finish(f"{result['frames']} frames into {result['table']}")
            else:
                result = track_into_bag(
                    arguments.video,
                    arguments.into,
                    target=arguments.out,
                    rig=rig,
                    has_exact_rate=arguments.exact_rate,
                    replaces=arguments.replace,
                    **film,
                )
                stage.finish(f"{result['frames']} frames into {result['bag']}")
        finally:
            # A film that is refused is what a picture explains.
            if explanation is not None:
                explanation.write(arguments.explain)
    text = _table_text if arguments.csv is not None else _text
    print(strict_json(result, indent=2) if arguments.json else text(result))
    return 0


def _table_text(result: dict[str, Any]) -> str:
    lines = []
    for name, marker in result["markers"].items():
        sigma = "" if marker["sigma_m"] is None else f", +- {marker['sigma_m'] * 1e6:.1f} um"
        lost = ", ".join(f"{why} {n}" for why, n in sorted(marker["reasons"].items()) if why != "ok")
        lines.append(
            f"{name}   seen in {marker['seen']} of {result['frames']} frames{sigma}"
            + (f" ({lost})" if lost else "")
        )
    lines += [f"note: {note}" for note in result["notes"]]
    return "\n".join([*lines, f"table    {result['table']}"])


def _text(result: dict[str, Any]) -> str:
    found = result["synchronisation"]
    rows = list(result["markers"].items())
    if "points" in result:
        seen = sorted(marker["seen"] for _, marker in rows)
        sigma = sorted(marker["sigma_m"] for _, marker in rows)
        lines = [
            f"strip    {len(rows)} points from {rows[0][0]} to {rows[-1][0]} mm, each seen in {seen[0]} to "
            f"{seen[-1]} of "
            f"{result['frames']} frames, +- {sigma[len(sigma) // 2] * 1e6:.1f} um"
        ]
    else:
        lines = [
            f"{name}   seen in {marker['seen']} of {result['frames']} frames, +- {marker['sigma_m'] * 1e6:.1f} um"
            for name, marker in rows
        ]
    lines += [
        f"offset   {found['offset_s']:.6f} +- {found['offset_sd_s']:.6f} s from the hub's first sample to the first "
        "frame",
        f"clock    {found['drift'] * 1e6:+.1f} +- {found['drift_sd'] * 1e6:.1f} ppm against the hub's",
        f"gain     {found['gain']:.4f} of the low marker over the hub, correlation {found['correlation']:.4f}, "
        f"residual {found['residual_rms_m'] * 1e6:.0f} um",
        *(f"note: {note}" for note in result["notes"]),
        f"bag      {result['bag']}",
    ]
    if result["original"] != result["bag"]:
        lines.append(f"before   {result['original']}")
    return "\n".join(lines)
