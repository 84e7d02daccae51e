"""JSON that every reader takes: it knows neither NaN nor infinities, which Python's own writer leaves in."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any


def strict_json(content: Any, indent: int | None = None) -> str:
    """Write plain lists, mappings and numbers as JSON; what is NaN or infinite becomes null."""
    return json.dumps(_without_nan(content), indent=indent, allow_nan=False)


def _without_nan(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
