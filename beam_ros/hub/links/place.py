"""Where a hub was measured last, and from where its positions count."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class HubPlace:
    """The newest measurement.

    Attributes
    ----------
    raw : float
        Position on the controller's own scale [m].
    velocity : float
        [m/s].
    zero : float
        Where home is on that scale [m].
    homes_here : bool
        Whether homing takes the present place for home; else the controller's own zero is home.
    """

    raw: float = 0.0
    velocity: float = 0.0
    zero: float = 0.0
    homes_here: bool = False

    @property
    def position(self) -> float:
        """From home [m]."""
        return self.raw - self.zero

    def take_home(self) -> None:
        """Set home where it is to be."""
        self.zero = self.raw if self.homes_here else 0.0
