"""The controls of the page: thresholds, the shape, and the area."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from nicegui import ui
from nicegui.elements.mixins.value_element import ValueElement

from shape_obs.tuner.controls import Control
from shape_obs.tuner.engine import Engine
from shape_obs.tuner.history import Path
from shape_obs.tuner.page_style import TOGGLE

_SHAPES: Final = {"centerline": "Cable", "contour": "Outline", "surface": "Cloth"}
_NAMES: Final = {"click": "Clicked colours", "click_net": "Clicked, by a network"}
_RULES: Final = {"hsv": "Colour range", "gray": "Brightness range", "depth": "Depth range"}
_COUNTS: Final = {"one": "One", **{str(k): str(k) for k in range(1, 9)}, "all": "All"}
_CHOICES: Final = {
    "centers": "Centres of pieces", "tips": "At the tips", "points": "In the image", "cloud": "In space",
    "px": "Pixels", "m": "Metres",
}  # fmt: skip
_MAIN: Final = ("n", "rows", "cols", "ends")  # of a shape; the others are under "More"


class Controls:
    """The column of controls.

    Args:
        engine: Whose session is changed.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine, self._session = engine, engine.session
        self._widgets: list[tuple[Callable[[], Any], ValueElement[Any]]] = []
        self._made_of: Any = None
        self._build()

    def refresh(self) -> None:
        """Show the present values; build the controls again if there are other ones."""
        if self._structure() != self._made_of:
            self._build.refresh()
        for read, widget in self._widgets:
            value = read()
            if widget.value != value:
                widget.set_value(value)
        self._show_texts()

    def _show_texts(self) -> None:
        settings = self._session.settings
        self._text.set_text(settings.text or ("" if self._session.rule else "Click on the object in the image."))
        clicks = len(settings.picks) + len(settings.nots)
        self._clear.set_visibility(clicks > 0)
        self._clear.set_text("Clear the click" if clicks == 1 else f"Clear {clicks} clicks")

    def _structure(self) -> Any:
        session = self._session
        controls = [(each.path, each.most) for each in (*session.rule_controls(), *session.shape_controls())]
        return session.shape.kind, session.rule and session.rule.kind, controls, session.config.roi.kind

    @ui.refreshable_method
    def _build(self) -> None:
        self._widgets, self._made_of = [], self._structure()
        with ui.card().classes("w-full p-4 gap-2 no-shrink"):
            self._object()
        with ui.card().classes("w-full p-4 gap-2"):
            self._shape()
        with ui.card().classes("w-full p-4 gap-2"):
            self._area()
        self._show_texts()

    def _object(self) -> None:
        session, rule = self._session, self._session.rule
        ui.label("Object").classes("tune-title")
        self._text = ui.label("").classes("tune-hint proposal")
        self._clear = ui.button("", on_click=session.clear_clicks).props("flat dense no-caps size=sm")
        self._clear.set_enabled(not session.read_only)
        rules: dict[Any, str] = {None: "Nothing yet"} if rule is None else {}
        rules |= _RULES
        frame = None if self._engine.result is None else self._engine.result.moment.frame
        if frame is None or frame.depth is None:
            del rules["depth"]
        if rule is not None:
            rules.setdefault(rule.kind, _NAMES.get(rule.kind, rule.kind.replace("_", " ").capitalize()))
        self._select("Found by", rules, lambda: self._session.rule and self._session.rule.kind, session.choose_rule)
        controls = session.rule_controls()
        common = [each for each in controls if each.path[-1] in ("open", "close", "min_area", "min_share")]
        for control in controls:
            if control not in common:
                self._control(control)
        if common:
            ui.separator()
        for control in common:
            self._control(control)

    def _shape(self) -> None:
        session = self._session
        ui.label("Shape").classes("tune-title")
        toggle = ui.toggle(_SHAPES, value=session.shape.kind, on_change=lambda e: self._choose_shape(e.value))
        toggle.props(f"{TOGGLE} spread")
        toggle.classes("w-full tune-toggle shapes")
        self._keep(lambda: self._session.shape.kind, toggle)
        controls = session.shape_controls()
        for control in controls:
            if control.path[-1] in _MAIN:
                self._control(control)
        self._select("How many", _COUNTS, self._count, self._choose_count)
        with ui.expansion("More").props("dense dense-toggle").classes("w-full text-sm"):
            for control in controls:
                if control.path[-1] not in _MAIN:
                    self._control(control)

    def _area(self) -> None:
        session, roi = self._session, self._session.config.roi
        ui.label("Area").classes("tune-title")
        with ui.row().classes("w-full items-center gap-2"):
            self._area_text = ui.label("").classes("tune-hint flex-1")
            whole = ui.button("Whole image", on_click=lambda: session.set_roi(None)).props("flat dense no-caps size=sm")
            whole.set_enabled(not session.read_only and roi.kind != "whole")
        texts = {
            "whole": "All of the image is searched. Choose Area above the image, and drag a rectangle.",
            "markers": "Between four ArUco markers, numbers 0 to 3.",
        }
        self._area_text.set_text(texts.get(roi.kind, "Only the area that you dragged is searched."))
        markers = ui.switch(
            "Between four markers", value=roi.kind == "markers", on_change=lambda e: self._markers(bool(e.value))
        )
        self._keep(lambda: self._session.config.roi.kind == "markers", markers)

    def _markers(self, on: bool) -> None:
        if on != (self._session.config.roi.kind == "markers"):
            self._session.set(("roi",), {"kind": "markers" if on else "whole"})

    def _choose_shape(self, kind: str) -> None:
        if kind != self._session.shape.kind:
            self._session.choose_shape(kind)

    def _count(self) -> str:
        count = self._session.shape.count
        return "one" if count is None else str(count)

    def _choose_count(self, text: str) -> None:
        count = {"one": None, "all": "all"}.get(text, text)
        self._session.set(("shapes", 0, "count"), int(count) if count not in (None, "all") else count)

    def _control(self, control: Control) -> None:
        def read() -> Any:
            return self._value(control.path)

        def change(value: Any) -> None:
            if value is not None and value != read():
                self._session.set(control.path, int(value) if control.whole else float(value))

        if control.type == "choice":
            names = {value: _CHOICES.get(value, str(value)) for value in control.choices}
            self._select(control.label, names, read, lambda value: self._session.set(control.path, value))
            return
        if control.type == "switch":
            switch = ui.switch(control.label, value=read(), on_change=lambda e: self._set(control.path, e.value))
            self._keep(read, switch)
            return
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.label(control.label).classes("text-sm").style("width: 128px; flex: none; line-height: 1.25")
            slider = ui.slider(min=control.least, max=control.most, step=control.step, value=read())
            slider.on_value_change(lambda e: change(e.value))
            slider.classes("flex-1 min-w-0").props(f'aria-label="{control.label}"')
            digits = "%d" if control.whole else "%.4g"
            number = ui.number(value=read(), step=control.step, format=digits, on_change=lambda e: change(e.value))
            number.props("dense borderless hide-bottom-space").classes("tune-number").style("width: 52px; flex: none")
        self._keep(read, slider)
        self._keep(read, number)

    def _set(self, path: Path, value: Any) -> None:
        if value != self._value(path):
            self._session.set(path, value)

    def _value(self, path: Path) -> Any:
        """Return a value; where a shape has none of its own, the detector's."""
        value = self._session.value(path)
        return getattr(self._session.config, str(path[-1]), None) if value is None else value

    def _select(
        self, label: str, choices: dict[Any, str], read: Callable[[], Any], change: Callable[[Any], Any]
    ) -> None:
        def changed(value: Any) -> None:
            if value is not None and value != read():
                change(value)

        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.label(label).classes("text-sm").style("width: 128px; flex: none")
            select = ui.select(choices, value=read(), on_change=lambda e: changed(e.value))
            select.props("dense outlined options-dense").classes("flex-1 min-w-0")
        self._keep(read, select)

    def _keep(self, read: Callable[[], Any], widget: ValueElement[Any]) -> None:
        """Keep a widget at the present value, whichever page changes it."""
        self._widgets.append((read, widget))
        if self._session.read_only:
            widget.props("disable")
