"""From the rig's film to the beam itself: stiffness and dampings from a start 30 % off."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cached_property

import numpy as np

from beam_ident import LogChirp, identify
from beam_model import Damping
from beam_model.fitting.physical_fit import ModalMeasurement, fit_beam
from benchmarks.ident.rig import Rig
from benchmarks.ident.study import AgainstBound, Outcome, Study

NAMES = ("stiffness", "viscous", "internal")


class PhysicalCase(AgainstBound):
    """EI/(rho L^4), viscous and internal damping; the time is that of the physical fit alone.

    The filmed beam obeys the same theory, so that no discrepancy of theory is allowed for.
    """

    def __init__(self, chirp: LogChirp | None = None) -> None:
        self.rig = Rig(Damping(viscous=0.02, internal=1e-5), chirp)
        beam = self.rig.parameters
        self.start = replace(
            beam,
            flexural_rigidity=1.3 * beam.flexural_rigidity,
            damping=Damping(viscous=1.3 * beam.damping.viscous, internal=1.3 * beam.damping.internal),
        )
        self.truth = np.array([beam.time_scale**-2, beam.damping.viscous, beam.damping.internal])

    @cached_property
    def bound(self) -> np.ndarray:
        """Return the standard deviations stated for one record."""
        sd = self.run(10**6).sd
        assert sd is not None
        return sd

    def run(self, seed: int) -> Outcome:
        """Identify one record and fit the beam to its modes."""
        model = identify(self.rig.record(seed)).model
        if model.n_modes != 3:
            return Outcome(0.0)
        measurement = ModalMeasurement.from_arrays(
            model.natural_frequencies, model.damping_ratios, model.covariance[:6, :6]
        )
        start = time.perf_counter()
        fit = fit_beam(measurement, self.start, NAMES, model_discrepancy=0.0, damping_discrepancy=0.0)
        return Outcome(time.perf_counter() - start, fit.values, fit.standard_deviations)


STUDIES = {"physical": Study("physical fit of the rig from +30 %", 400, PhysicalCase)}
