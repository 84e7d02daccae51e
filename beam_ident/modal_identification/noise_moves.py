"""Moves of samples and noise: outliers that hide modes, noise of the input that only the outputs show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from beam_ident.data.records import TimeRecord
from beam_ident.modal_estimation.record_levels import without_outliers
from beam_ident.modal_identification.estimation import End
from beam_ident.modal_identification.search_moves import Estimate, SearchMove
from beam_ident.modal_identification.unseen_noise import Leftover, unseen_noise
from beam_ident.sensing.still_noise import StillNoise

_OUTLIER_LOOKS = 3  # at records without the outliers seen so far


class OutlierMask(SearchMove):
    """Outliers are left out where the search, by least squares, finds other modes without them.

    The last fit weighs outliers as what they are, but it has the modes that the search has found beside them.
    Every look without those that are seen may show smaller ones.
    """

    about = "modes that outliers hide"

    def __init__(self) -> None:
        self._looks_left = _OUTLIER_LOOKS
        self._whole: Sequence[TimeRecord] | None = None

    def end(self, present: End, estimate: Estimate) -> End | None:
        """Return the end without the outliers that are seen, where it has other modes."""
        conditions, found = present.conditions, present.result
        self._whole = self._whole or conditions.measured
        if not self._looks_left or conditions.clocks or conditions.jumps:  # residuals have other stamps then
            return None
        self._looks_left -= 1
        cleaned = without_outliers(conditions.measured, found.outputs)
        if cleaned is None:
            return None
        counts = [
            f"{missing} of {len(own.times_s)} samples of {own.name}"
            for own in found.outputs
            if (missing := _n_valid(self._whole, own.name) - _n_valid(cleaned, own.name))
        ]
        said = f"Outliers: {', '.join(counts)} hid modes from the search, or feigned some, and are left out."
        masked = replace(
            conditions, measured=cleaned, sentences={**conditions.sentences, "outliers": said}, start=None
        )
        following = estimate(masked, None)
        if present.n_modes is None:
            is_better = following.result.model.n_modes != found.model.n_modes
        else:
            is_better = sum(map(bool, following.result.doubts)) < sum(map(bool, found.doubts))
        return following if is_better else None


def _n_valid(records: Sequence[TimeRecord], name: str) -> int:
    """Return how many samples of an output count."""
    return sum(int(np.sum(one.output(name).is_valid)) for one in records if name in one.output_names)


class UnseenInputNoise(SearchMove):
    """Noise of the input that its own samples hide is weighed as if it had been stated."""

    about = "noise of the input that its samples do not show"

    def end(self, present: End, estimate: Estimate) -> End | None:
        """Return the end with inputs of the noise that the residuals show, where it converges."""
        result, measured = present.result, present.conditions.measured
        model = result.model
        if len(model.input_names) > 1 or not (result.converged and result.band.is_excited):
            return None
        drives = [one.input(model.input_name) for one in measured]
        if any(own.sigma > 0.0 for own in drives) or all(own.whiteness.is_white for own in result.outputs):
            return None
        leftovers = []
        for place, own in enumerate(result.outputs):
            seen = [k for k, one in enumerate(measured) if own.name in one.output_names]
            if len(seen) != len(own.records):
                return None
            late = model.latency + float(model.output_delays[place])
            for k, part in zip(seen, own.records, strict=True):
                output = measured[k].output(own.name)
                drive = drives[k].seen_through(model.low_passes.get(own.name, output.low_pass))
                leftovers.append(
                    Leftover(place, part.times_s - late, part.residuals, output.exposure_s, drive)
                )
        noise = StillNoise(unseen_noise(model, leftovers), is_behind=True)
        if not noise.sigma > 0.0:
            return None
        noisy = [
            replace(
                one,
                inputs=tuple(replace(own, sigma=noise.sigma) if own is drive else own for own in one.inputs),
            )
            for one, drive in zip(measured, drives, strict=True)
        ]
        found_noise = dict.fromkeys(range(len(measured)), noise)
        weighed = replace(present.conditions, measured=noisy, found_noise=found_noise)
        following = estimate(weighed, None)
        return following if following.result.converged else None
