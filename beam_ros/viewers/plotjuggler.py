"""A layout of PlotJuggler 3: a tab for the running rig, and one for a flat bag."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from beam_ros.viewers.curves import COLOURS, Plot, flat_plots, live_plots

_BUFFER_S = 30


def plotjuggler_layout(markers: Sequence[str], namespace: str = "") -> str:
    """Return the layout as XML.

    Parameters
    ----------
    markers : sequence of str -- their names
    namespace : str -- of the rig; empty for none
    """
    root = ElementTree.Element("root")
    tabs = ElementTree.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    for name, plots in (("rig", live_plots(markers)), ("flat bag", flat_plots(markers))):
        tab = ElementTree.SubElement(tabs, "Tab", tab_name=name, containers="1")
        container = ElementTree.SubElement(tab, "Container")
        share = f"{1 / len(plots):.6f}"
        splitter = ElementTree.SubElement(
            container,
            "DockSplitter",
            orientation="-",
            count=str(len(plots)),
            sizes=";".join([share] * len(plots)),
        )
        for plot in plots:
            _add_plot(splitter, plot, namespace)
    ElementTree.SubElement(tabs, "currentTabIndex", index="0")
    ElementTree.SubElement(root, "use_relative_time_offset", enabled="1")
    ElementTree.SubElement(root, "Plugins")
    ElementTree.SubElement(root, "previouslyLoaded_Datafiles")
    ElementTree.SubElement(root, "previouslyLoaded_Streamer", name="ROS2 Topic Subscriber")
    ElementTree.indent(root, " ")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ElementTree.tostring(root, encoding='unicode')}\n"


def _add_plot(parent: ElementTree.Element, plot: Plot, namespace: str) -> None:
    area = ElementTree.SubElement(parent, "DockArea", name=plot.title)
    drawn = ElementTree.SubElement(
        area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false"
    )
    ElementTree.SubElement(drawn, "range", left="0", right=str(_BUFFER_S), bottom="-0.01", top="0.01")
    ElementTree.SubElement(drawn, "limitY")
    for colour, curve in zip(COLOURS, plot.curves, strict=False):
        prefix = f"/{namespace}" if namespace else ""
        name = f"{prefix}/{curve.topic}/{curve.joint}/{curve.field}"
        ElementTree.SubElement(drawn, "curve", name=name, color=colour)
