"""Film the simulated experiment with whatever disturbs a camera, and write the truth beside the film.

For trying a tracker, this suite's or one of your own. The rig's own parameters say the most (-p camera.noise:=5.0,
-p camera.readout:=0.01, -p simulation.full_well:=8000.0, -p simulation.frame_drops:=0.02, -p excitation.kind:=..);
the options below say what no rig should have. The folder then holds the film, the bag of the hub without
displacements, the rig file, and truth.csv with every marker's true column and displacement in every frame.
"""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path

from beam_ros.cli.options import add_rig_file, quiet_opencv, read_rig
from beam_ros.process.progress import Progress
from beam_ros.process.strict_json import strict_json

_FAULTS = {
    "gain": (float, "FACTOR", "of the camera: above 1 the brightest saturate"),
    "jpeg": (int, "QUALITY", "compress every frame, 1 to 100"),
    "light-step": (float, "FACTOR", "light from the middle of the film on"),
    "flicker": (float, "SHARE", "of the light, at 100.3 Hz"),
    "gradient": (float, "SHARE", "rise of the light from left to right"),
    "texture": (float, "GREY", "of the ground behind the beam"),
    "strip-texture": (float, "SHARE", "of the strip along its length"),
    "drift": (float, "PX", "of the camera, a frame"),
    "shake": (float, "PX", "of the camera, standard deviation"),
    "twins": (int, "N", "resting spots like markers beside the beam"),
    "cover": (float, "SHARE", "of the frames in which something hides a part of the beam"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's arguments."""
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FOLDER", help="new folder of film and truth"
    )
    parser.add_argument("--whole", action="store_true", help="the strip alone, lit, without dots")
    parser.add_argument("--strip-contrast", type=float, metavar="GREY", help="strip above the ground")
    parser.add_argument(
        "--strip-width", type=float, metavar="PX", help="of the strip in the image (default: beam.thickness)"
    )
    parser.add_argument(
        "--container",
        choices=("mkv", "avi"),
        default="mkv",
        help="with the time of every frame, or without (default: mkv)",
    )
    parser.add_argument(
        "--images", action="store_true", help="the frames on camera/image_raw in the bag, too"
    )
    parser.add_argument(
        "--uneven", type=float, default=0.0, metavar="S", help="frames come by up to so much sooner or later"
    )
    parser.add_argument("--row-step", type=int, default=10, metavar="N", help="rows of a point of the strip")
    parser.add_argument("--seed", type=int, help="seed of everything random (simulation.seed)")
    for name, (kind, unit, meaning) in _FAULTS.items():
        parser.add_argument(f"--{name}", type=kind, metavar=unit, help=meaning)
    add_rig_file(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    quiet_opencv()
    from beam_ros.offline.film_rendering import FilmOrder, render_film
    from beam_ros.vision.rendering.imaging import CameraFaults

    rig = read_rig(arguments)
    if arguments.seed is not None:
        rig = rig.with_values({"simulation.seed": arguments.seed})
    given = {field.name: getattr(arguments, field.name) for field in fields(CameraFaults)}
    order = FilmOrder(
        CameraFaults(**{name: value for name, value in given.items() if value is not None}),
        is_whole=arguments.whole,
        strip_contrast=arguments.strip_contrast,
        strip_width_px=arguments.strip_width,
        container=arguments.container,
        keeps_images=arguments.images,
        unevenness_s=arguments.uneven,
        row_step=arguments.row_step,
    )
    with Progress("render", 1.0) as stage:
        result = render_film(
            rig, arguments.out, order, lambda done_s, total_s: stage.update(done_s / total_s)
        )
        stage.finish(f"{result['frames']} frames in {result['film']}")
    if arguments.json:
        print(strict_json(result, indent=2))
    else:
        print(f"film     {result['film']}, {result['frames']} frames\nbag      {result['bag']}")
        print(f"truth    {arguments.out / 'truth.csv'}, {len(result['points'])} points")
    return 0
