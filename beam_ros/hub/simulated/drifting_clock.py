"""The true map between a device's clock and the host's, which a host with a real device can only estimate."""

from __future__ import annotations

_BILLION = 1_000_000_000


class DriftingClock:
    """A clock that was set at some time, and runs fast or slow from then on.

    Parameters
    ----------
    host_ns, device_ns : int
        When it was set by the host's clock, and to what [ns].
    drift_ppm : float
        By how much it runs fast [1e-6].
    """

    def __init__(self, host_ns: int, device_ns: int, drift_ppm: float) -> None:
        self._rate_ppb = round(drift_ppm * 1000)
        self.set(host_ns, device_ns)

    def set(self, host_ns: int, device_ns: int) -> None:
        """Set it anew; it drifts as before."""
        self._host_ns, self._device_ns = host_ns, device_ns

    def change_rate(self, host_ns: int, ppm: float) -> None:
        """Let it run faster from a time of the host on [ns] by so much more [1e-6]."""
        self.set(host_ns, self.device_ns(host_ns))
        self._rate_ppb += round(ppm * 1000)

    def device_ns(self, host_ns: int) -> int:
        """Return what it reads at a time of the host [ns]."""
        elapsed_ns = host_ns - self._host_ns
        return self._device_ns + elapsed_ns + elapsed_ns * self._rate_ppb // _BILLION

    def host_ns(self, device_ns: int) -> int:
        """Return when it reads that, by the host's clock [ns]."""
        elapsed_ns = device_ns - self._device_ns
        return self._host_ns + elapsed_ns * _BILLION // (_BILLION + self._rate_ppb)
