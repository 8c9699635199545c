"""The image of the page: clicks, dragged areas, the player below it, and what was found."""

from __future__ import annotations

import re
from typing import Final

from nicegui import events, run, ui

from shape_obs.shape import Detection
from shape_obs.tuner.engine import Engine
from shape_obs.tuner.page_style import TOGGLE
from shape_obs.tuner.pictures import scale_of

_MODES: Final = {"pick": "On the object", "not": "Not the object", "area": "Area"}
_HINTS: Final = {
    "pick": "Click on the object. Shift-click on what is not the object.",
    "not": "Click on what is not the object.",
    "area": "Drag a rectangle around the area to look in.",
}
_STREAM: Final = """
const image = document.querySelector("#%s img");
if (!image.dataset.page) {
  image.dataset.page = "%s";
  let count = 0;
  const next = async () => {
    try {
      const answer = await fetch(`/picture/${image.dataset.page}/${count++}.jpg`);
      if (!answer.ok) throw new Error(answer.status);
      const before = image.src;
      image.src = URL.createObjectURL(await answer.blob());
      await image.decode();
      if (before.startsWith("blob:")) URL.revokeObjectURL(before);
      setTimeout(next, 0);
    } catch (error) {
      setTimeout(next, 500);
    }
  };
  next();
}
"""
_SMALLEST: Final = 8  # pixels of an area's sides; a shorter drag was a click

_ADVICE: Final[tuple[tuple[str, str], ...]] = (
    (r"mask is empty", "No pixel matches. Click on the object, or widen the thresholds."),
    (r"mask has \d+ pixels, at least", "Hardly any pixel matches. Click on the object again, or widen the thresholds."),
    (r"runs of pixels|noise", "The mask looks like noise. Shift-click on the background, or raise 'Remove specks'."),
    (r"too stout", "The mask is no longer than wide. If it is no cable, choose Outline or Cloth."),
    (r"too slender for a sheet", "The mask is long and thin. Choose Cable as the shape."),
    (r"falls into \d+ pieces", "The mask is in many pieces. Raise 'Close gaps', or click on a missing part."),
    (r"longer in space|end-on", "The object points at the camera. Move it or the camera."),
    (r"markers?\b.*(missing|not|seen)|missing.*marker", "The four markers are not all in sight."),
    (r"px wide", "The mask is very thin. Lower 'Remove specks', or move the camera closer."),
    (r"in sight|hidden|covered", "Too much of the object is hidden or outside the area."),
    (r"off the|outside the mask|not explain|covers?\b", "The mask is more than the object, or has holes."),
    (r"as many pixels as", "The mask became much larger. Something of the same colour came into view."),
    (r"from where the shape was", "It jumped. Another object of the same colour may be in view."),
    (r"corner", "The four corners of the cloth are not clear in the mask."),
    (r"small", "The mask is too small. Click on the object again, or move the camera closer."),
)  # fmt: skip
_ELSE: Final = "Look at the mask under Stages: it should cover the object, and nothing else."


class ImagePanel:
    """The newest picture with the clicks on it.

    Args:
        engine: What is shown.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine, self._session = engine, engine.session
        self._overlay, self._size, self._is_busy = "", (0, 0), False
        self._begin: tuple[float, float] | None = None
        self._end: tuple[float, float] | None = None
        with ui.card().classes("w-full p-3 gap-2 tune-image"):
            with ui.row().classes("w-full items-center gap-x-3 gap-y-1"):
                self._mode = ui.toggle(dict(_MODES), value="pick", on_change=self._choose)
                self._mode.props(TOGGLE)
                self._mode.classes("tune-toggle mode").set_enabled(not self._session.read_only)
                self._hint = ui.label(_HINTS["pick"]).classes("tune-hint")
            self._image = ui.interactive_image(
                "/newest.jpg", on_mouse=self._mouse, events=["click"], content=" ", sanitize=False
            ).classes("w-full rounded self-center tune-pick")
            ui.context.client.on_connect(self._stream)
            self._player()
            self._status()

    def _draw_clicks(self) -> None:
        overlay = self._svg()
        if overlay != self._overlay:
            self._overlay = overlay
            self._image.set_content(overlay)

    def _stream(self) -> None:
        """Let the browser load one picture after the other; see ``add_page``."""
        client = ui.context.client
        client.run_javascript(_STREAM % (self._image.html_id, client.id))

    def _fit_to_window(self) -> None:
        """Make the image as wide as leaves room for what is below it."""
        result = self._engine.result
        if result is not None and result.size != self._size:
            self._size = result.size
            ratio = result.size[1] / max(result.size[0], 1)
            self._image.style(f"max-width: max(280px, calc((100vh - 300px) * {ratio:.4f}))")

    def refresh(self) -> None:
        """Bring the texts and the player up to date."""
        engine, player = self._engine, self._engine.player
        self._fit_to_window()
        self._draw_clicks()
        self._play.props(f"icon={'pause' if engine.playing and engine.state != 'ended' else 'play_arrow'}")
        self._bar.set_visibility(engine.live or player.length != 1 or player.seekable is None)
        position, length = max(engine.position, 0), player.length
        self._scrub.props(f"max={max(length - 1, 1)}")
        if self._scrub.value != position:
            self._moving = True
            self._scrub.set_value(position)
            self._moving = False
        self._place.set_text(f"{position + 1} / {length}" if player.seekable is not None else f"last {length}")
        self._show_status()

    def _player(self) -> None:
        engine, plain = self._engine, "flat dense round"
        self._moving = False
        with ui.row().classes("w-full items-center no-wrap gap-1") as self._bar:
            ui.button(icon="skip_previous", on_click=lambda: engine.step(-1)).props(f"{plain} aria-label=Back")
            self._play = ui.button(icon="pause", on_click=self._toggle).props(f"{plain} aria-label=Play")
            ui.button(icon="skip_next", on_click=lambda: engine.step(1)).props(f"{plain} aria-label=Step")
            self._scrub = ui.slider(min=0, max=1, step=1, value=0, on_change=self._scrubbed)
            self._scrub.classes("flex-1 mx-2 min-w-0 scrub")
            self._place = ui.label("").classes("tune-hint whitespace-nowrap text-right").style("min-width: 64px")

    def _toggle(self) -> None:
        engine = self._engine
        (engine.pause if engine.playing and engine.state != "ended" else engine.play)()

    def _scrubbed(self, event: events.ValueChangeEventArguments) -> None:
        if not self._moving and event.value is not None:
            self._engine.go(int(event.value))

    def _status(self) -> None:
        with ui.row().classes("w-full items-center gap-x-3 gap-y-1"):
            with ui.row().classes("items-center no-wrap gap-2"):
                self._icon = ui.icon("radio_button_unchecked", size="20px").classes("text-grey-6")
                self._found = ui.label("").classes("tune-title found")
            self._quality = ui.label("").classes("tune-hint")
            self._speed = ui.label("").classes("tune-hint speed")
        with ui.column().classes("w-full gap-0 rounded px-3 py-2 reason").style("background: #fdf1e3") as self._box:
            self._advice = ui.label("").style("color: #7a4a06; font-size: 14px")
            self._reason = ui.label("").style("color: #8a6a3c; font-size: 12px")

    def _show_status(self) -> None:
        engine, result = self._engine, self._engine.result
        detection = None if result is None else result.detection
        problems = [] if detection is None else explanations(detection)
        error = self._session.error or ("" if result is None else result.error)
        if engine.state in ("lost", "waiting", "released") or (engine.message and engine.state != "ended"):
            problems.insert(0, ("source", engine.message, _advice_on_source(engine)))
        if error:
            problems.insert(0, ("", "", error))
        self._box.set_visibility(bool(problems))
        if problems:
            name, reason, advice = problems[0]
            self._advice.set_text(advice)
            self._reason.set_text(f"{name}: {reason}" if reason else "")
            self._reason.set_visibility(bool(reason))
        good = detection is not None and detection.ok
        nothing = detection is None and not error
        self._icon.props(f"name={'check_circle' if good else 'radio_button_unchecked' if nothing else 'error'}")
        self._icon.classes(replace="text-positive" if good else "text-grey-6" if nothing else "text-warning")
        text = "Click on the object in the image" if detection is None else summary(detection)
        self._found.set_text("Looking for what you clicked on ..." if self._is_busy else text)
        shapes = [] if detection is None else [shape for shape in detection if shape.ok]
        self._quality.set_text(f"quality {min(shape.quality for shape in shapes):.2f}" if shapes else "")
        rate = f" · {engine.updates_per_second:.0f} updates/s" if engine.playing and engine.state == "playing" else ""
        total = engine.latencies.get("total")
        self._speed.set_text("" if total is None else f"{total:.1f} ms{rate}")

    def _choose(self, event: events.ValueChangeEventArguments) -> None:
        self._begin = self._end = None
        self._hint.set_text(_HINTS[event.value])
        dragging = event.value == "area"
        self._image.classes(remove="tune-area tune-pick", add="tune-area" if dragging else "tune-pick")
        self._image.props["events"] = ["pointerdown", "pointermove", "pointerup"] if dragging else ["click"]
        self._image.update()

    async def _mouse(self, event: events.MouseEventArguments) -> None:
        result = self._engine.result
        if result is None or self._session.read_only:
            return
        scale = scale_of(result.size)
        pixel = ((event.image_x + 0.5) / scale - 0.5, (event.image_y + 0.5) / scale - 0.5)
        if event.type == "click":
            on_object = self._mode.value == "pick" and not event.shift
            frame = result.moment.frame
            self._is_busy = True
            try:
                await run.io_bound(lambda: self._session.click(frame, pixel, on_object=on_object))
            finally:
                self._is_busy = False
        elif event.type == "pointerdown":
            self._begin = self._end = pixel
        elif self._begin is not None:
            self._end = pixel
            self._draw_clicks()
            if event.type == "pointerup" or not event.buttons:
                begin, self._begin, self._end = self._begin, None, None
                if min(abs(begin[0] - pixel[0]), abs(begin[1] - pixel[1])) >= _SMALLEST:
                    self._session.set_roi((begin, pixel))
                    self._mode.set_value("pick")

    def _svg(self) -> str:
        """Return the clicks and the rectangle that is being dragged, in the pixels of the picture."""
        result = self._engine.result
        if result is None:
            return " "
        scale = scale_of(result.size)
        picks, nots = self._session.clicks_in(result.moment.frame)
        radius = max(result.size[1] * scale / 90, 5.0)
        parts = []
        for pixels, colour, sign in ((picks, "#1a8f4c", "+"), (nots, "#c62f3b", "−")):
            for u, v in pixels:
                x, y = (u + 0.5) * scale, (v + 0.5) * scale
                parts.append(
                    f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="{colour}" stroke="white" '
                    f'stroke-width="1.5"/><text x="{x:.1f}" y="{y:.1f}" fill="white" text-anchor="middle" '
                    f'dominant-baseline="central" font-size="{1.7 * radius:.0f}">{sign}</text>'
                )
        if self._begin is not None and self._end is not None:
            (u, v), (other_u, other_v) = self._begin, self._end
            left, top = min(u, other_u) * scale, min(v, other_v) * scale
            parts.append(
                f'<rect x="{left:.1f}" y="{top:.1f}" width="{abs(u - other_u) * scale:.1f}" '
                f'height="{abs(v - other_v) * scale:.1f}" fill="#1e6fd933" stroke="#1e6fd9" stroke-width="2"/>'
            )
        return "".join(parts) or " "


def _advice_on_source(engine: Engine) -> str:
    if engine.state == "lost":
        return "The camera is gone. Check its cable; it is used again as soon as it is back."
    if engine.state == "waiting":
        return "No frame comes from the camera. Waiting for it."
    return "" if engine.state == "released" else "A frame cannot be read; it is left out."


def summary(detection: Detection) -> str:
    """Return what was found, in a line: how many points of how many shapes, or that nothing was."""
    found = [shape for shape in detection if shape.ok]
    if not found:
        return "Not found"
    points = sum(len(shape.visible) for shape in found)
    seen = sum(int(shape.visible.sum()) for shape in found)
    several = f" on {len(found)} objects" if len(detection) > 1 else ""
    lost = f", {len(detection) - len(found)} not found" if len(found) < len(detection) else ""
    return f"{points} points{several}, {'all' if seen == points else seen} visible{lost}"


def advice(reason: str) -> str:
    """Return what to do about the reason of a refusal."""
    for pattern, text in _ADVICE:
        if re.search(pattern, reason):
            return text
    return _ELSE


def explanations(detection: Detection) -> list[tuple[str, str, str]]:
    """Return (name, reason, advice) of each shape that was refused, and of a warning about the frame."""
    refused = [(shape.name, shape.reason, advice(shape.reason)) for shape in detection if shape.reason]
    if detection.warning and not any(detection.warning in reason for _, reason, _ in refused):
        refused.append(("frame", detection.warning, "The camera's clock is at fault; the shape is still followed."))
    return refused
