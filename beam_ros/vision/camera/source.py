"""A camera that a process of the suite reads itself: the seam behind which devices, videos and other makes lie.

A laboratory adds a camera of its own, such as a manufacturer's library, as a package with a ``CameraSource`` and an
entry point of the group ``beam_ros.camera_sources``: a callable that makes it from the ``Rig``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from beam_ros.arrays import ImageArray
from beam_ros.vision.parameters import StampMeaning


@dataclass(frozen=True)
class CapturedFrame:
    """A frame with the time that its source gives it.

    Attributes
    ----------
    stamp_ns : int -- [ns, UNIX]
    image : ndarray, shape (height, width), uint8 or uint16
    stamp_means : "start", "mid", "end", "arrival" or None -- the instant of the exposure that the stamp is, where the
        source knows; where it is not what ``camera.stamp`` says, a warning is reported
    """

    stamp_ns: int
    image: ImageArray
    stamp_means: StampMeaning | None = None


class CameraSource(ABC):
    """A camera, opened, read and closed by one thread; after a failure it is opened again.

    Attributes
    ----------
    name : str -- of the camera, in messages
    is_paced : bool -- True for a recording, whose frames are there before their time: it begins when somebody
        listens, and every frame is held back until its stamp
    remarks : tuple of str -- what is not as it was asked for; each is reported as a warning while the camera runs
    """

    name: str
    is_paced: bool = False
    remarks: tuple[str, ...] = ()

    @abstractmethod
    def open(self) -> None:
        """Begin.

        Raises
        ------
        CaptureError
            The camera cannot be opened.
        """

    @abstractmethod
    def read(self) -> CapturedFrame | None:
        """Wait for the next frame; None when there will be no more.

        Raises
        ------
        CaptureError
            The camera gives no more frames, although it should.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the camera; it may be closed already."""
