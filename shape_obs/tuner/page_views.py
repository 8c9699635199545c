"""The views below the image: stages, space, colours, points and times."""

from __future__ import annotations

import time
from typing import Any, Final

import numpy as np
from nicegui import ui

from shape_obs.shape import Detection
from shape_obs.tuner.colours import CHANNELS, cloud_of, histogram
from shape_obs.tuner.engine import Engine
from shape_obs.tuner.pictures import STAGES
from shape_obs.tuner.result import Result

_EVERY: Final = 0.5  # seconds between updates of what costs time
_VIEWS: Final = {"stages": "Stages", "space": "3D", "colours": "Colours", "points": "Points", "times": "Times"}
_TIMES: Final = {
    "roi": "Find the markers", "segmentation": "Find the mask", "cloud": "Make the cloud", "fit": "Fit the form",
    "lift": "Points and depth", "total": "Together",
}  # fmt: skip


class Views:
    """The tabs below the image; only the one that is open is computed.

    Args:
        engine: What is shown.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._shown: tuple[Any, ...] = ()
        self._next, self._far = 0.0, 1.0
        self._scene: ui.scene | None = None
        self._cloud: Any = None
        self._marks: list[Any] = []
        with ui.card().classes("w-full p-0 gap-0"):
            self._tabs = ui.tabs().props("dense no-caps align=left inline-label").classes("w-full")
            with self._tabs:
                for name, label in _VIEWS.items():
                    ui.tab(name, label)
            with ui.tab_panels(self._tabs, value="stages", animated=False, keep_alive=True).classes("w-full"):
                with ui.tab_panel("stages").classes("p-3"):
                    self._build_stages()
                with ui.tab_panel("space").classes("p-3"):
                    self._build_space()
                with ui.tab_panel("colours").classes("p-3"):
                    self._build_colours()
                with ui.tab_panel("points").classes("p-3"):
                    self._build_points()
                with ui.tab_panel("times").classes("p-3"):
                    self._times = ui.column().classes("w-full gap-1")

    def refresh(self) -> None:
        """Bring the open view up to date, unless it shows the newest result or was updated just now."""
        result, view = self._engine.result, self._tabs.value
        wanted = (view, self._engine.number, self._channel.value)
        if result is None or wanted == self._shown:
            return
        if time.monotonic() < self._next and self._shown[:1] == (view,):
            return
        self._shown, self._next = wanted, time.monotonic() + _EVERY
        show = {
            "stages": self._show_stages, "space": self._show_space, "colours": self._show_colours,
            "points": self._show_points, "times": self._show_times,
        }[str(view)]  # fmt: skip
        show(result)

    def _build_stages(self) -> None:
        self._stages = {}
        with (
            ui.element("div")
            .classes("w-full grid gap-3")
            .style("grid-template-columns: repeat(auto-fill, minmax(min(280px, 46%), 1fr))")
        ):
            for name, title in STAGES.items():
                with ui.column().classes("gap-1 min-w-0"):
                    ui.label(title).classes("tune-hint")
                    self._stages[name] = (
                        ui.interactive_image().classes("w-full rounded").style("border: 1px solid #e4e8ee")
                    )

    def _show_stages(self, result: Result) -> None:
        for name, image in self._stages.items():
            image.set_source(f"/stage/{name}/{result.number}.jpg")

    def _build_space(self) -> None:
        self._no_space = ui.label(
            "There is no 3D: the source has no depth, or its intrinsics are unknown. A photo takes --depth FILE and "
            "--intrinsics FX FY CX CY."
        ).classes("tune-hint")
        self._space = ui.element("div").classes("w-full")

    def _show_space(self, result: Result) -> None:
        cloud = cloud_of(result)
        self._no_space.set_visibility(cloud is None)
        self._space.set_visibility(cloud is not None)
        if cloud is None or not len(cloud.points):
            return
        if self._scene is None:  # one that is made while it is hidden has no size
            with self._space:
                self._scene = ui.scene(width=640, height=420, grid=False, background_color="#f7f9fb")
                self._scene.classes("w-full").style("height: 420px")
        scene = self._scene
        points = _upright(cloud.points)
        with scene:
            if self._cloud is None:
                self._cloud = scene.point_cloud(points.tolist(), cloud.colours.tolist(), 0.8 * cloud.size)
                self._look_at(scene, points, points[cloud.inside])
            else:
                self._cloud.set_points(points.tolist(), cloud.colours.tolist())
            for mark in self._marks:
                mark.delete()
            self._marks = [] if result.detection is None else self._draw(scene, result.detection)

    def _look_at(self, scene: ui.scene, points: np.ndarray, inside: np.ndarray) -> None:
        """Look from where the camera is, and a little from above."""
        middle = np.median(inside if len(inside) else points, axis=0)
        self._far = float(np.percentile(np.linalg.norm(points - middle, axis=1), 80))
        x, y, z = middle.tolist()
        scene.move_camera(x, y - 0.9 * self._far, z + 0.5 * self._far, x, y, z, 0, 0, 1, duration=0)

    def _draw(self, scene: ui.scene, detection: Detection) -> list[Any]:
        marks = []
        for shape in detection:
            if shape.points3d is None or not shape.ok:
                continue
            points = _upright(shape.points3d.astype(float))
            known = np.asarray(np.isfinite(points).all(axis=1))
            for first, second in shape.layout.edges():
                if known[first] and known[second]:
                    line = scene.line(points[first].tolist(), points[second].tolist()).material("#1f2a37")
                    marks.append(line)
            for i in np.flatnonzero(known).tolist():
                colour = "#1a8f4c" if shape.valid[i] else "#b7791f"
                ball = scene.sphere((0.024 if i == 0 else 0.015) * self._far, 12, 8).material(colour)
                marks.append(ball.move(*points[i].tolist()))
        return marks

    def _build_colours(self) -> None:
        with ui.row().classes("w-full items-center gap-3"):
            self._channel = ui.toggle(list(CHANNELS), value="Hue")
            self._channel.classes("tune-toggle").props(
                "dense no-caps unelevated toggle-color=primary color=grey-3 text-color=grey-9"
            )
            ui.label("Good thresholds lie where the two colours do not overlap.").classes("tune-hint")
        self._chart = ui.echart(
            {
                "animation": False,
                "grid": {"left": 44, "right": 12, "top": 36, "bottom": 28},
                "legend": {"top": 4, "data": ["on the object", "elsewhere"]},
                "xAxis": {"type": "value", "min": 0, "max": 179},
                "yAxis": {"type": "value", "axisLabel": {"formatter": "{value} %"}},
                "series": [
                    {"name": "on the object", "type": "line", "step": "middle", "symbol": "none",
                     "areaStyle": {"opacity": 0.25}, "color": "#d6249f", "data": []},
                    {"name": "elsewhere", "type": "line", "step": "middle", "symbol": "none",
                     "areaStyle": {"opacity": 0.2}, "color": "#64748b", "data": []},
                ],
            }
        ).classes("w-full").style("height: 260px")  # fmt: skip

    def _show_colours(self, result: Result) -> None:
        channel = str(self._channel.value)
        found = histogram(result, channel)
        options = self._chart.options
        options["xAxis"]["max"] = CHANNELS[channel] - 1
        for series, values in zip(options["series"], (found.inside, found.outside), strict=True):
            series["data"] = np.stack([found.centres, values], axis=1).round(2).tolist()
        self._chart.update()

    def _build_points(self) -> None:
        names = ("shape", "point", "u", "v", "x", "y", "z", "state")
        columns = [{"name": each, "label": each, "field": each, "align": "right"} for each in names]
        self._table = ui.table(columns=columns, rows=[], row_key="key").props("dense flat").classes("w-full points")
        ui.label("u, v in pixels; x, y, z in metres in the frame of the camera, where there is depth.").classes(
            "tune-hint"
        )

    def _show_points(self, result: Result) -> None:
        rows = []
        for shape in result.detection or ():
            for i in range(len(shape.visible) if shape.ok else 0):
                row: dict[str, Any] = {"key": f"{shape.name} {i}", "shape": shape.name, "point": i}
                for names, points, digits in (("uv", shape.points2d, 1), ("xyz", shape.points3d, 3)):
                    for axis, name in enumerate(names if points is not None else ""):
                        assert points is not None
                        row[name] = f"{points[i, axis]:.{digits}f}"
                row["state"] = "seen" if shape.visible[i] else "hidden"
                rows.append(row)
        self._table.rows = rows

    def _show_times(self, result: Result) -> None:
        self._times.clear()
        latencies = dict(self._engine.latencies)
        total = max(latencies.get("total", 0.0), 1e-6)
        with self._times:
            if not latencies:
                ui.label("Nothing was measured yet.").classes("tune-hint")
            for stage, ms in latencies.items():
                with ui.row().classes("w-full items-center no-wrap gap-3"):
                    ui.label(_TIMES.get(stage, stage)).classes("text-sm").style("width: 130px; flex: none")
                    bar = ui.linear_progress(min(ms / total, 1.0), show_value=False, size="10px")
                    bar.props("instant-feedback rounded").classes("flex-1")
                    ui.label(f"{ms:.2f} ms").classes("text-sm text-right").style("width: 72px; flex: none")


def _upright(points: np.ndarray) -> np.ndarray:
    """Return points of the camera's frame (right, down, forward) as the scene has them (right, forward, up)."""
    return np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)
