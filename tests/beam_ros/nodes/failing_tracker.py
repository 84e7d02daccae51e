"""Run the tracker with an error of its own: it divides by the first pixel of every frame."""

from __future__ import annotations

import sys

from beam_ros.nodes.vision_tracker import main
from beam_ros.vision.repeats import RepeatedImages

is_repeated = RepeatedImages.is_repeated


def failing(self, image):
    """Do what the tracker does, but for a frame whose first pixel is black."""
    return 1 // int(image[0, 0]) == 1 or is_repeated(self, image)


if __name__ == "__main__":
    RepeatedImages.is_repeated = failing
    sys.exit(main())
