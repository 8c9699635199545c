"""Where things are in a rerun recording, and the blueprint that shows them side by side."""

from __future__ import annotations

from collections.abc import Set
from typing import Any, Final

WORLD: Final = "camera"  # the camera's optical frame; its parent is the base frame
IMAGE: Final = "camera/image"  # what lies below has pixels as coordinates
PLOTS: Final = "plots"
LOG: Final = "log"


def layout(views: Set[str]) -> Any:
    """Return a blueprint: the image on the left, space on the right, plots and texts below.

    Args:
        views: What there is to see: ``"image"``, ``"space"``, ``"detection"`` and ``"features"``.
    """
    import rerun.blueprint as rrb

    upper: list[Any] = []
    if "image" in views:
        contents = ["$origin/**", "- $origin/depth"]
        upper.append(rrb.Spatial2DView(origin=f"/{IMAGE}", name="image", contents=contents))
    if "space" in views:
        flat = [f"- /{IMAGE}/{name}/**" for name in ("shapes", "mask", "crossings", "goals")]
        upper.append(rrb.Spatial3DView(origin="/", name="space", contents=[f"/{WORLD}/**", *flat]))
    lower: list[Any] = []
    hidden = rrb.PlotLegend(visible=False)  # it would cover the lines; the pointer shows their names
    if "detection" in views:
        quality = [f"/{PLOTS}/quality/**", f"/{PLOTS}/valid/**"]
        lower.append(rrb.TimeSeriesView(origin=f"/{PLOTS}", name="quality and valid share", contents=quality))
        lower.append(rrb.TimeSeriesView(origin=f"/{PLOTS}/timings", name="milliseconds by stage"))
    if "features" in views:
        lower.append(rrb.TimeSeriesView(origin=f"/{PLOTS}/features", name="features", plot_legend=hidden))
    if lower:
        lower.append(rrb.TextLogView(origin=f"/{LOG}", name="reasons"))
    rows = [rrb.Horizontal(*part) for part in (upper, lower) if part]
    container = rrb.Vertical(*rows, row_shares=[3, 1][: len(rows)]) if rows else rrb.Vertical()
    return rrb.Blueprint(container, rrb.TimePanel(state="collapsed"), collapse_panels=True)
