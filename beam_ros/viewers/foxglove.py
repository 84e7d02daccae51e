"""A layout that Foxglove and Lichtblick import: plots, the tracker's picture, the beam in space, health and mode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from beam_ros.interfaces.graph import RIG_FRAME
from beam_ros.process.strict_json import strict_json
from beam_ros.viewers.curves import COLOURS, Plot, live_plots


def foxglove_layout(markers: Sequence[str], namespace: str = "") -> str:
    """Return the layout as JSON.

    Parameters
    ----------
    markers : sequence of str -- their names
    namespace : str -- of the rig; empty for none
    """
    prefix = f"/{namespace}/" if namespace else "/"
    plots = {f"Plot!{k}": _plot(plot, prefix) for k, plot in enumerate(live_plots(markers), start=1)}
    panels: dict[str, dict[str, Any]] = {
        **plots,
        "Image!tracker": {
            "imageMode": {"imageTopic": f"{prefix}tracker/debug_image"},
            "foxglovePanelTitle": "what the tracker sees",
        },
        "3D!beam": {
            "followTf": RIG_FRAME,
            "followMode": "follow-none",
            "topics": {f"{prefix}{topic}": {"visible": True} for topic in ("beam/shape", "beam/markers")},
            "foxglovePanelTitle": "the beam",
        },
        "RawMessages!mode": {"topicPath": f"{prefix}hub/mode.data"},
        "DiagnosticSummary!health": {"topicToRender": "/diagnostics", "minLevel": 0, "sortByLevel": True},
    }
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split(
            "row",
            _split("column", *plots),
            _split("column", *(name for name in panels if name not in plots)),
        ),
    }
    return strict_json(layout, indent=1) + "\n"


def _plot(plot: Plot, prefix: str) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": plot.title,
        "isSynced": True,
        "showLegend": len(plot.curves) > 1,
        "xAxisVal": "timestamp",
        "paths": [
            {
                "value": f"{prefix}{curve.topic}.{curve.field}[{curve.index}]",
                "label": curve.joint,
                "color": colour,
                "enabled": True,
                "timestampMethod": "headerStamp",
            }
            for colour, curve in zip(COLOURS, plot.curves, strict=False)
        ],
    }


def _split(direction: str, *parts: Any) -> Any:
    """Return panels beside or above each other, each with the same share."""
    if len(parts) == 1:
        return parts[0]
    share = round(100 / len(parts), 3)
    rest = _split(direction, *parts[1:])
    return {"direction": direction, "first": parts[0], "second": rest, "splitPercentage": share}
