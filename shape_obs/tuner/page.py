"""The page: its frame, its header, and what is kept up to date on it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from fastapi import FastAPI, Response
from nicegui import context, run, ui

from shape_obs.tuner.engine import Engine
from shape_obs.tuner.page_controls import Controls
from shape_obs.tuner.page_image import ImagePanel
from shape_obs.tuner.page_style import STYLE
from shape_obs.tuner.page_views import Views
from shape_obs.tuner.pictures import STAGES, encode, stage_picture

_TEXT_EVERY: Final = 0.2  # seconds
_POLL: Final = 0.004
_LONGEST: Final = 2.0
_STATES: Final = {
    "starting": ("starting", "grey-6"),
    "playing": ("live", "positive"),
    "paused": ("paused", "grey-7"),
    "ended": ("ended", "grey-7"),
    "waiting": ("no frame", "warning"),
    "lost": ("camera lost", "negative"),
    "released": ("released", "grey-7"),
}


def add_page(app: FastAPI, engine: Engine, save_path: Path, is_closing: Callable[[], bool]) -> None:
    """Add the page and its pictures to an application.

    Args:
        app: The application.
        engine: What all pages show.
        save_path: The file that Save writes.
        is_closing: Whether the server is about to end, so that no request waits any longer.
    """
    sent: dict[str, int] = {}

    @app.get("/picture/{page}/{request}.jpg")
    async def picture(page: str, request: str) -> Response:
        """Return the newest picture as soon as there is one that the page does not have, and at the latest in a while.

        So each page gets as many as it can show, always the newest, and asks again when it has shown one.
        """
        end = time.monotonic() + _LONGEST
        while sent.get(page) == engine.number and time.monotonic() < end and not is_closing():
            await asyncio.sleep(_POLL)
        sent[page] = engine.number
        return Response(engine.jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @app.get("/newest.jpg")
    def newest() -> Response:
        """Return the newest picture at once."""
        return Response(engine.jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @app.get("/stage/{name}/{number}.jpg")
    def stage(name: str, number: str) -> Response:
        """Return the picture of a stage."""
        if engine.result is None or name not in STAGES:
            return Response(status_code=404)
        jpeg = encode(stage_picture(engine.result, name))
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @ui.page("/")
    def page() -> None:
        _Page(engine, save_path)


class _Page:
    """One browser's page."""

    def __init__(self, engine: Engine, save_path: Path) -> None:
        self._engine, self._session, self._save_path = engine, engine.session, save_path
        self._version = -1
        ui.colors(primary="#1e6fd9", positive="#1a8f4c", negative="#c62f3b", warning="#b7791f")
        ui.add_css(STYLE)
        self._header()
        with ui.element("div").classes("tune-body"):
            with ui.element("div").classes("tune-left"):
                self._image = ImagePanel(engine)
            with ui.column().classes("tune-right w-full gap-4 min-w-0"):
                self._controls = Controls(engine)
            with ui.element("div").classes("tune-below"):
                self._views = Views(engine)
        ui.timer(_TEXT_EVERY, self._refresh)
        ui.keyboard(on_key=self._key)
        self._count_page()
        self._refresh()

    def _count_page(self) -> None:
        client, opened = context.client, []

        def opens() -> None:
            if not opened:  # a page that reconnects is the same page
                opened.append(True)
                self._engine.open_page()

        client.on_connect(opens)
        client.on_delete(lambda: self._engine.close_page() if opened else None)

    def _header(self) -> None:
        source = self._engine.player.source
        with (
            ui.header().classes("items-center no-wrap gap-2 px-3 py-2").style("background: #17212e"),
            ui.row().classes("w-full items-center no-wrap gap-2"),
        ):
            ui.label("shape-obs tune").classes("text-base font-semibold tune-wide")
            ui.label(Path(source.name).name or source.name).classes("text-sm ellipsis opacity-80 min-w-0").tooltip(
                source.name
            )
            self._state = ui.badge("starting").props("rounded").classes("px-2 py-1")
            ui.space()
            light = "flat dense color=white"
            self._undo = (
                ui.button(icon="undo", on_click=self._session.undo)
                .props(f"{light} aria-label=Undo")
                .tooltip("Undo (Ctrl+Z)")
            )
            self._redo = (
                ui.button(icon="redo", on_click=self._session.redo)
                .props(f"{light} aria-label=Redo")
                .tooltip("Redo (Ctrl+Y)")
            )
            ui.button(icon="code", on_click=self._show_python).props(f"{light} aria-label=Python").tooltip(
                "Copy as Python"
            )
            self._save = ui.button("Save", on_click=self._save_file).props("dense unelevated no-caps")
            self._save.classes("px-4").tooltip(f"Write {self._save_path}")
        self._save.set_enabled(not self._session.read_only)

    def _key(self, event: object) -> None:
        key, modifiers, action = (getattr(event, name) for name in ("key", "modifiers", "action"))
        if action.keydown and (modifiers.ctrl or modifiers.meta) and key.name in ("z", "y"):
            (self._session.undo if key.name == "z" else self._session.redo)()

    def _refresh(self) -> None:
        """Bring all texts up to date."""
        engine, session = self._engine, self._session
        text, colour = _STATES[engine.state]
        if engine.player.source.kind == "photo":
            text = "photo"
        elif engine.state == "playing" and not engine.live:
            text = "playing"
        self._state.set_text("read-only, " + text if session.read_only else text)
        self._state.props(f"color={colour}")
        if self._version != session.version:
            self._version = session.version
            self._undo.set_enabled(session.can_undo)
            self._redo.set_enabled(session.can_redo)
            self._controls.refresh()
        self._image.refresh()
        self._views.refresh()

    async def _save_file(self) -> None:
        try:
            await run.io_bound(self._session.save, self._save_path)
        except (ValueError, OSError) as error:
            ui.notify(str(error), type="warning", position="top")
            return
        with ui.dialog(value=True) as dialog, ui.card().classes("w-full gap-2"):
            ui.label(f"Saved {self._save_path}").classes("tune-title")
            ui.label("Every command reads it, for example:").classes("tune-hint")
            ui.code(_commands(self._engine, self._save_path), language="bash").classes("w-full")
            ui.button("Close", on_click=dialog.close).props("flat dense").classes("self-end")

    def _show_python(self) -> None:
        source = self._engine.player.source
        with ui.dialog(value=True) as dialog, ui.card().classes("w-full gap-2").style("max-width: 760px"):
            ui.label("The same in Python").classes("tune-title")
            text = self._session.python(source.name, source.kind, str(self._save_path))
            if str(self._save_path) in text:
                ui.label(f"It reads {self._save_path}: press Save first.").classes("tune-hint")
            ui.code(text, language="python").classes("w-full python-code")
            with ui.row().classes("w-full justify-end"):
                ui.button("Copy", icon="content_copy", on_click=lambda: self._copy(text)).props("flat dense")
                ui.button("Close", on_click=dialog.close).props("flat dense")

    def _copy(self, text: str) -> None:
        ui.clipboard.write(text)
        ui.notify("Copied. If your browser forbids it here, mark the text and copy it.", position="top")


def _commands(engine: Engine, path: Path) -> str:
    name = engine.player.source.name
    if engine.player.source.kind == "photo":
        return f"shape-obs detect {name} --config {path}"
    if engine.live:
        record = f"shape-obs record --source {name} --seconds 10 -o recording\n"
        return f"{record}shape-obs replay recording --config {path} --video shapes.mp4"
    return f"shape-obs replay {name} --config {path} --video shapes.mp4"
