"""Stored results of any kind, read back: one function for files whose contents are not known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from beam_ident.amplitude.curves import AmplitudeCurves
from beam_ident.axis.axis_result import AxisResult
from beam_ident.best_linear.result import BestLinearApproximation
from beam_ident.data.frequency_record import FrequencyRecord
from beam_ident.errors import ModelFormatError
from beam_ident.excitation.recipe import Recipe
from beam_ident.modal.free_decay_result import FreeDecay
from beam_ident.modal.model import ModalModel
from beam_ident.modal_analysis.refinement import ModalAnalysis
from beam_ident.subspace.model import SubspaceModel
from beam_ident.transfer_function.model import TransferFunctionModel
from beam_ident.transfer_function.multi_input_model import MultiInputModel

Stored = (
    ModalModel
    | TransferFunctionModel
    | MultiInputModel
    | SubspaceModel
    | AmplitudeCurves
    | AxisResult
    | BestLinearApproximation
    | FreeDecay
    | ModalAnalysis
    | FrequencyRecord
    | Recipe
)

_READERS: dict[str, Callable[[Mapping[str, Any]], Stored]] = {
    "modal_model": ModalModel.from_dict,
    "transfer_function": TransferFunctionModel.from_dict,
    "multi_input_model": MultiInputModel.from_dict,
    "subspace_model": SubspaceModel.from_dict,
    "amplitude_curves": AmplitudeCurves.from_dict,
    "axis": AxisResult.from_dict,
    "best_linear_approximation": BestLinearApproximation.from_dict,
    "free_decay": FreeDecay.from_dict,
    "modal_analysis": ModalAnalysis.from_dict,
    "frequency_record": FrequencyRecord.from_dict,
}


def restore(data: Mapping[str, Any]) -> Stored:
    """Rebuild a model, an analysis, a frequency record or a recipe from what its ``to_dict`` returned.

    Parameters
    ----------
    data : mapping -- ``json.loads`` of stored text

    Raises
    ------
    ModelFormatError
        Not something that this version stores, or something that the type's own ``from_dict`` refuses.
    """
    if isinstance(data, Mapping) and "type" not in data and "kind" in data:
        return Recipe.from_dict(data)
    found = data.get("type") if isinstance(data, Mapping) else type(data).__name__
    if not isinstance(data, Mapping) or not isinstance(found, str) or found not in _READERS:
        raise ModelFormatError(
            f"not a stored result, but {found!r}; expected a mapping whose type is one of {', '.join(_READERS)}, or "
            "an excitation recipe"
        )
    return _READERS[found](data)
