"""A rig's theory on one page: what a person reads and a machine parses.

Numbers for people are in Hz and millimetres; their names say so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from beam_model.advice.experiment_advice import (
    ExperimentAdvice,
    advise,
    aliases,
    node_heights,
    relative_amplitudes,
)
from beam_model.advice.validity import validity
from beam_model.arrays import FloatArray
from beam_model.galerkin.model import BeamModel


@dataclass(frozen=True)
class ModelSummary:
    """The modes of a rig as its markers and its camera see them.

    Attributes
    ----------
    frequencies_hz, damping_ratios : ndarray, shape (n_modes,)
        Of the clamped beam: hub motion prescribed.
    free_hub_frequencies_hz, free_hub_damping_ratios : ndarray, shape (n_modes,)
        Under a force on the free hub.
    participation_factors, effective_mass_fractions : ndarray, shape (n_modes,)
        How strongly hub acceleration drives each mode, and the share of the beam's mass that it carries.
    marker_heights_mm : ndarray, shape (n_markers,)
    marker_amplitudes : ndarray, shape (n_markers, n_modes)
        Of each mode at each marker over its largest amplitude; below 0.1 a marker hardly sees the mode.
    residues : ndarray, shape (n_markers, n_modes)
        r of the response to hub motion.
    nodes_mm : tuple of ndarray
        Where each mode does not move.
    aliases_hz : ndarray, shape (n_modes,)
        Where each mode appears in frames at ``frame_rate_hz``.
    frame_rate_hz : float
    advice : ExperimentAdvice
    doubts : tuple of str
        Where the theory does not hold.
    """

    frequencies_hz: FloatArray
    damping_ratios: FloatArray
    free_hub_frequencies_hz: FloatArray
    free_hub_damping_ratios: FloatArray
    participation_factors: FloatArray
    effective_mass_fractions: FloatArray
    marker_heights_mm: FloatArray
    marker_amplitudes: FloatArray
    residues: FloatArray
    nodes_mm: tuple[FloatArray, ...]
    aliases_hz: FloatArray
    frame_rate_hz: float
    advice: ExperimentAdvice
    doubts: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return plain lists and numbers, ready for JSON; a settling time without damping is null."""
        advice = self.advice
        result: dict[str, Any] = {
            name: getattr(self, name).tolist()
            for name in (
                "frequencies_hz",
                "damping_ratios",
                "free_hub_frequencies_hz",
                "free_hub_damping_ratios",
                "participation_factors",
                "effective_mass_fractions",
                "marker_heights_mm",
                "marker_amplitudes",
                "residues",
                "aliases_hz",
            )
        }
        result["nodes_mm"] = [nodes.tolist() for nodes in self.nodes_mm]
        result["frame_rate_hz"] = self.frame_rate_hz
        result["doubts"] = list(self.doubts)
        result["advice"] = {
            "n_modes": advice.n_modes,
            "marker_heights_mm": (1000.0 * advice.marker_heights).tolist(),
            "visibility": advice.visibility.tolist(),
            "frame_rate_hz": advice.frame_rate,
            "excitation_band_hz": list(advice.excitation_band),
            "half_power_bandwidths_hz": advice.half_power_bandwidths.tolist(),
            "settling_time_s": advice.settling_time if np.isfinite(advice.settling_time) else None,
        }
        return result

    def to_text(self) -> str:
        """Return the page for a person."""
        lines = [
            "mode   clamped          damping   free hub         damping   participation   beam mass   in frames at "
            f"{self.frame_rate_hz:g} Hz"
        ]
        for k, frequency in enumerate(self.frequencies_hz):
            alias = f"{self.aliases_hz[k]:.2f} Hz"
            if self.damping_ratios[k] >= 1.0:
                alias = "does not oscillate"
            elif frequency <= 0.5 * self.frame_rate_hz:
                alias = "as it is"
            lines.append(
                f"{k + 1:4d}   {frequency:9.4f} Hz   {100 * self.damping_ratios[k]:7.3f} %   "
                f"{self.free_hub_frequencies_hz[k]:9.4f} Hz   {100 * self.free_hub_damping_ratios[k]:7.3f} %   "
                f"{self.participation_factors[k]:13.4f}   {100 * self.effective_mass_fractions[k]:7.2f} %   {alias}"
            )
        if self.marker_heights_mm.size:
            lines += [
                "",
                "amplitude at the markers, of each mode's largest (below 10 % a marker hardly sees it)",
            ]
            for height, row in zip(self.marker_heights_mm, self.marker_amplitudes, strict=True):
                lines.append(f"{height:7.1f} mm " + "".join(f"{100.0 * value:8.1f} %" for value in row))
        advice = self.advice
        heights = " and ".join(f"{1000.0 * height:.0f} mm" for height in advice.marker_heights)
        settling = f"{advice.settling_time:.0f} s" if np.isfinite(advice.settling_time) else "never, undamped"
        low, high = advice.excitation_band
        lines += [
            "",
            f"for the first {advice.n_modes} modes",
            f"  markers            {heights}, beside one near the hub",
            f"  frame rate         above {advice.frame_rate:.0f} Hz, or exact stamps and a direct fit",
            f"  excitation band    {low:.2f} to {high:.1f} Hz",
            "  half-power bands   " + ", ".join(f"{width:.3f} Hz" for width in advice.half_power_bandwidths),
            f"  settling to 0.1 %  {settling}",
        ]
        if self.doubts:
            lines += ["", "where the theory does not hold", *(f"  {doubt}" for doubt in self.doubts)]
        return "\n".join(lines)


def summarise(
    model: BeamModel,
    marker_heights: ArrayLike = (),
    frame_rate: float = 100.0,
    n_advised: int = 3,
    amplitude: float = 0.0,
) -> ModelSummary:
    """Return a rig's theory on one page.

    Parameters
    ----------
    model : BeamModel
    marker_heights : array_like
        Above the clamp [m].
    frame_rate : float
        Of the camera [Hz].
    n_advised : int
        How many modes the advice is for; no more than the model has.
    amplitude : float
        How far the tip is bent [m]; 0: as little as linear theory means.
    """
    heights = np.array(
        model.parameters.check_heights(np.atleast_1d(np.asarray(marker_heights, dtype=np.float64)))
    )
    n = model.n_modes
    seen = heights.size > 0
    f = model.natural_frequencies / (2.0 * np.pi)
    return ModelSummary(
        frequencies_hz=f,
        damping_ratios=model.damping_ratios,
        free_hub_frequencies_hz=model.free_hub_natural_frequencies / (2.0 * np.pi),
        free_hub_damping_ratios=model.free_hub_damping_ratios,
        participation_factors=model.participation_factors,
        effective_mass_fractions=model.effective_mass_fractions,
        marker_heights_mm=1000.0 * heights,
        marker_amplitudes=relative_amplitudes(model, heights) if seen else np.zeros((0, n)),
        residues=model.motion_residues(heights) if seen else np.zeros((0, n)),
        nodes_mm=tuple(1000.0 * node_heights(model, mode) for mode in range(n)),
        aliases_hz=aliases(f, frame_rate),
        frame_rate_hz=float(frame_rate),
        advice=advise(model, min(n_advised, n)),
        doubts=validity(model, min(n_advised, n), amplitude),
    )
