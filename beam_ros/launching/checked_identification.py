"""A bag identified by the identifier's parameters, with what its check found in the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from beam_ident.report.gates import Gate
from beam_ros.checks.bag_check import BagCheck, check_bag
from beam_ros.interfaces.rig_parameters import IdentifierSettings
from beam_ros.offline.loading.options import FitOptions
from beam_ros.process.remote_paths import AnyPath
from beam_ros.reporting.identification import identify_told


def identify_checked(
    settings: IdentifierSettings, progress: Callable[[str, float], None] = lambda phrase, share: None
) -> dict[str, Any]:
    """Check, identify and report the bags of ``identifier.bag``.

    Parameters
    ----------
    settings : IdentifierSettings -- without a folder for the report, it goes beside the first bag
    progress : callable -- called with a phrase and the share done

    Returns
    -------
    dict -- what ``identification/result`` carries

    Raises
    ------
    BagError, UsageError, ParameterFileError, IdentificationError
    """
    if not settings.report:
        first = Path(settings.bag.partition(";")[0].strip())
        settings = replace(settings, report=str(first.with_name(f"{first.name}_identified")))
    checks: list[BagCheck] = []

    def check(path: AnyPath, options: FitOptions) -> Sequence[Gate]:
        checks.append(check_bag(path, None, options))
        return checks[-1].gates

    outcome = identify_told(settings, progress=progress, checked=check)
    return {**outcome, "checks": [own.to_dict() for own in checks]}
