"""The picture of 'The model of the tracker': uv run python docs/pictures/model.py."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from failures import over
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from sheet import HIDDEN_KEY, VALID_KEY, Key, grid, legend, save, titled
from stages import IMAGES, photograph

from shape_obs import Centerline, Shape, ShapeDetector
from shape_obs.drawing import HIDDEN, VALID, draw_curve, draw_point
from tests.scenes.hidden_ropes import Seen, hidden_ropes

Array = Any
N = 20
RATE = 30.0  # frames a second
SEED, APPROACH, SPEED = 1, 5.0, 4.0  # pixels a frame
MIDDLE = 10  # a point that is always in sight
TRUTH = (210, 40, 160)
LETTERS = 21  # pixels of a sheet about 1290 pixels wide
MARGIN = 34  # pixels around the rope and the hand
PLOT = (1288, 560)


class Moment(NamedTuple):
    """One frame: what the camera saw, what came out, and where its points are in truth."""

    seen: Seen
    shape: Shape
    truth: Array

    @property
    def cover(self) -> Array:
        """``(H, W)`` where the hand is: nearer than the table, and not the rope."""
        return ((self.seen.depth < self.seen.depth.max()) & (self.seen.mask == 0)).astype(np.uint8)

    @property
    def error(self) -> Array:
        """``(N,)`` pixels per axis."""
        return np.linalg.norm(self.shape.pixels - self.truth, axis=1) / np.sqrt(2)


def follow() -> list[Moment]:
    """Follow a rope in a mask, without depth, while a hand comes over its end, stays, and goes."""
    detector, moments = ShapeDetector([Centerline(n=N, ends="tips")]), []
    backwards = False
    for k, seen in enumerate(hidden_ropes(np.random.default_rng(SEED), "hand", APPROACH, SPEED)):
        shape = detector.detect_mask(seen.mask, stamp=k / RATE).shapes[0]
        at, along = np.arange(len(seen.pixels)), np.linspace(0, len(seen.pixels) - 1, N)
        truth = np.stack([np.interp(along, at, column) for column in seen.pixels.T], axis=1)
        if k == 0:
            first, last = (np.linalg.norm(shape.pixels[0] - truth[end]) for end in (0, -1))
            backwards = bool(last < first)
        moments.append(Moment(seen, shape, truth[::-1] if backwards else truth))
    return moments


def frame(moment: Moment, window: tuple[slice, slice]) -> Array:
    """Draw a frame with its points, the circles of the hidden ones, and where these are in truth."""
    picture = over(photograph({"centerline": moment.seen.mask}), moment.cover)
    hidden = ~moment.shape.visible
    if hidden.any():
        draw_curve(picture, moment.truth[hidden], TRUTH, thickness=2)
    for point, sigma in zip(moment.shape.pixels[hidden], moment.shape.sigma[hidden], strict=True):
        cv2.circle(picture, np.rint(point).astype(int).tolist(), round(float(sigma)), HIDDEN, 1, cv2.LINE_AA)
    for point, unseen in zip(moment.shape.pixels, hidden, strict=True):
        draw_point(picture, point.astype(np.float64), HIDDEN if unseen else VALID)
    for point in moment.truth[hidden]:
        cv2.circle(picture, np.rint(point).astype(int).tolist(), 4, TRUTH, -1, cv2.LINE_AA)
    return picture[window]


def plot(moments: list[Moment], shown: list[int], end: int) -> Array:
    """Draw sigma and error over time, of the end that is hidden for a while and of a point that never is."""
    times, hidden = np.arange(len(moments)) / RATE, np.array([not m.shape.visible[end] for m in moments])
    sigma, error = np.array([m.shape.sigma for m in moments]), np.array([m.error for m in moments])
    size = 0.72 * LETTERS  # points, at 100 dots per inch
    figure = Figure(figsize=(PLOT[0] / 100, PLOT[1] / 100), dpi=100, layout="constrained")
    panels = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1))
    for axis, point, colour, most, name in zip(
        panels,
        (end, MIDDLE),
        (HIDDEN, VALID),
        (46, 2.3),
        ("the end point", "a point in sight"),
        strict=True,
    ):
        ink = tuple(0.85 * part / 255 for part in colour)
        axis.axvspan(*times[hidden][[0, -1]], color="#f0e2d8", zorder=0)
        axis.plot(times, sigma[:, point], color=ink, linewidth=3, label="sigma")
        axis.plot(times, error[:, point], color="#22313f", linewidth=1.8, linestyle=(0, (3, 1.2)), label="true error")
        for moment in shown:
            axis.axvline(times[moment], color="#8a949e", linewidth=1.2, zorder=1)
        axis.set(xlim=(0, times[-1]), ylim=(0, most))
        axis.set_ylabel("px per axis", fontsize=size)
        axis.tick_params(labelsize=size)
        axis.text(0.01, 0.94, name, fontsize=size, va="top", transform=axis.transAxes)
    for letter, moment in zip("abcd", shown, strict=True):
        panels[0].annotate(
            letter, (times[moment], 1.02), xycoords=("data", "axes fraction"), ha="center", fontsize=size
        )
    panels[0].text(times[shown[1:3]].mean(), 43.5, "the hand is over the end", fontsize=size, ha="center", va="top")
    panels[0].legend(fontsize=size, frameon=False, loc="upper right")
    panels[1].set_xlabel("time [s]", fontsize=size)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def picture() -> Array:
    """Draw four frames, their legend, and the errors over time."""
    moments = follow()
    end = 0 if any(not m.shape.visible[0] for m in moments) else N - 1
    hidden = np.flatnonzero([not m.shape.visible[end] for m in moments])
    shown = [int(hidden[0]) - 6, int(hidden[0]) + 12, int(hidden[-1]) - 26, int(hidden[-1]) + 8]
    titles = "before", "the hand comes", "the hand stays, the rope moves", "the hand has gone"
    marks = np.concatenate([np.argwhere((moments[k].seen.mask > 0) | (moments[k].cover > 0)) for k in shown])
    (top, left), (bottom, right) = marks.min(axis=0) - MARGIN, marks.max(axis=0) + MARGIN
    window = slice(max(top, 0), bottom), slice(max(left, 0), right)
    frames = [
        titled(enlarged(frame(moments[k], window)), f"{letter}: {title}, {k / RATE:.1f} s", LETTERS)
        for k, title, letter in zip(shown, titles, "abcd", strict=True)
    ]
    film = grid(frames, 2)
    keys = VALID_KEY, HIDDEN_KEY, Key("circle of radius sigma", HIDDEN, "line"), Key("true place", TRUTH, "dot")
    drawn = plot(moments, shown, end)
    size = film.shape[1], round(len(drawn) * film.shape[1] / drawn.shape[1])
    drawn = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
    return np.concatenate([film, legend(keys, film.shape[1], LETTERS), drawn])


def enlarged(image: Array) -> Array:
    """Return a frame at half of the width of the picture."""
    wide = (PLOT[0] - 8) // 2
    return cv2.resize(image, (wide, round(len(image) * wide / image.shape[1])), interpolation=cv2.INTER_CUBIC)


if __name__ == "__main__":
    save(IMAGES / "model.jpg", picture(), 200_000)
