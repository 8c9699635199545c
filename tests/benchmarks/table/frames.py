"""Draw the frames of the table, and trace them: thinning and contours give as many points as there are pixels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from functools import partial
from importlib.util import find_spec
from typing import Any, Final, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.bench.photos import BLUE, photographed
from shape_obs.bench.scenes import Sheet, border_of, draw_sheet, moving_sheet
from shape_obs.configurations.base import Configuration
from shape_obs.configurations.centerline import Centerline
from shape_obs.configurations.contour import Contour
from shape_obs.configurations.surface import Surface
from shape_obs.frame import Frame
from shape_obs.geometry.polyline import nearest_on
from shape_obs.image.roi import Whole
from shape_obs.image.segmentation import Segmentation
from shape_obs.metrics import in_order
from tests.benchmarks import Clock
from tests.benchmarks.interleaved_timing import CLOCKS, timed
from tests.benchmarks.scenes.streams import outline_pixels
from tests.benchmarks.tables import Row

Array = npt.NDArray[np.float64]
Name = Literal["centerline", "contour", "surface"]
CONFIGURATIONS: Final[dict[Name, Configuration]] = {
    "centerline": Centerline(n=20, ends="centers"),
    "contour": Contour(n=32),
    # The anchor makes the rows run along the cloth's long side; otherwise the cells of some cloths would be slivers.
    "surface": Surface(rows=4, cols=8, ends="centers", anchor="corner"),
}
# Drawn cloths: the aspect makes the cells of 4 x 8 about square, the size gives some 20,000 pixels.
_ASPECT: Final = 2.0
_SHRUNK: Final = 0.84
_SPEED: Final = 6.0  # pixels a frame
_LIGHT: Final = 1.5  # brighter in one corner than in the other
_NOISE: Final = 6.0  # gray levels
_BLUR: Final = 0.7  # pixels
Mask = npt.NDArray[np.uint8]
Tracing = Literal["thinning", "contours", "corners"]
OF: Final[dict[Tracing, Name]] = {"thinning": "centerline", "contours": "contour", "corners": "contour"}


class Scene(NamedTuple):
    """One frame.

    Args:
        rgb: ``(H, W, 3)`` uint8.
        mask: The segmented mask, ``(H, W)`` uint8.
        truth: The known axis from end to end, or the known outline, clockwise as seen, (P, 2) pixels; of a surface the
            known cloth.
    """

    rgb: npt.NDArray[np.uint8]
    mask: npt.NDArray[np.uint8]
    truth: Array | Sheet

    @property
    def anchors(self) -> dict[str, tuple[float, float]]:
        """Anchors in pixels by name: the corner at which a cloth's lattice begins."""
        if not isinstance(self.truth, Sheet):
            return {}
        u, v = self.truth.points[0, 0]
        return {"corner": (float(u), float(v))}


def scenes(name: Name, chunk: int, count: int, seed: int, renderer: str) -> Iterator[Scene]:
    """Draw the frames of one chunk, which is an episode; any process draws the same ones.

    Args:
        name: ``"centerline"``: the simulated cable under random actions in front of the simulated D455. ``"contour"``
            and ``"surface"``: a drawn cloth that wanders, turns and bends.
        chunk: Number of the chunk.
        count: Number of frames in it.
        seed: Seed of the whole run.
        renderer: The simulator's renderer: ``"auto"``, ``"gl"`` or ``"rays"``.
    """
    source = np.random.SeedSequence([seed, list(CONFIGURATIONS).index(name), chunk])
    if name == "centerline":
        yield from _cable(source, count, renderer)
    else:
        for photo, sheet in _cloth(np.random.default_rng(source), count):
            yield Scene(photo, _segmented(BLUE, photo), border_of(sheet.points) if name == "contour" else sheet)


def _cable(source: np.random.SeedSequence, count: int, renderer: str) -> Iterator[Scene]:
    import gymnasium as gym

    seed = int(source.generate_state(1)[0])
    with closing(gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera="d455", renderer=renderer)) as env:
        simulator: Any = env.unwrapped
        rule = Segmentation.from_dict(simulator.shape_obs_defaults["segmentation"])
        env.action_space.seed(seed)
        observation, _ = env.reset(seed=seed)
        for step in range(count):
            if step:
                observation, *_ = env.step(env.action_space.sample())
            truth = simulator.truth(n=400, frame="pixels", surface=True)
            yield Scene(observation["rgb"], _segmented(rule, observation["rgb"]), truth)


def _cloth(rng: np.random.Generator, count: int) -> Iterator[tuple[npt.NDArray[np.uint8], Sheet]]:
    for large in moving_sheet(rng, _SPEED / _SHRUNK, count, aspect=_ASPECT):
        height, width = large.mask.shape
        middle = np.array([width, height]) / 2
        sheet = draw_sheet(middle + _SHRUNK * (large.points - middle))
        photo = photographed(rng, sheet.mask, _LIGHT, _NOISE)
        yield np.asarray(cv2.GaussianBlur(photo, (0, 0), _BLUR), dtype=np.uint8), sheet


def _segmented(rule: Segmentation, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    frame = Frame(rgb, None, None, None)
    assert frame.size is not None
    return rule.apply(frame, Whole().window(frame.size))


def _thinned(mask: Mask) -> Array:
    from skimage.morphology import skeletonize

    left, top, width, height = cv2.boundingRect(mask)
    rows, columns = np.nonzero(skeletonize(mask[top : top + height, left : left + width] > 0))
    return np.stack([columns + left, rows + top], axis=1).astype(np.float64)


_RUN: Final[dict[Tracing, Callable[[Mask], Array]]] = {
    "thinning": _thinned,
    "contours": outline_pixels,
    "corners": partial(outline_pixels, approximation=cv2.CHAIN_APPROX_SIMPLE),
}


def missing(tracing: Tracing) -> str:
    """Return why a tracing cannot run here, or an empty string."""
    if tracing == "thinning" and find_spec("skimage") is None:
        return "scikit-image is not installed (OpenCV's thinning is in opencv-contrib alone)"
    return ""


def traced(tracing: Tracing, chunk: Iterable[tuple[int, Scene]], clock: Clock = "wall") -> Iterator[Row]:
    """Trace the numbered frames of one chunk.

    Yields:
        Number of the ``frame`` and of ``points``; ``start``: position of the first point on the material, as a share of
        the known curve's length; ``ordered``: whether the points follow each other along the known curve; ``tips``:
        pixels of a thinned mask with one neighbour, two for a rope, 0 for a contour; ``ms``.
    """
    run, now, closed = _RUN[tracing], CLOCKS[clock], OF[tracing] == "contour"
    for frame, scene in chunk:
        assert not isinstance(scene.truth, Sheet)
        points, ms = timed(partial(run, scene.mask), now)
        curve = np.concatenate([scene.truth, scene.truth[:1]]) if closed else scene.truth
        length = float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum())
        arc = nearest_on(curve, points)[0]
        ordered = any(in_order(way, length if closed else None) for way in (arc, arc[::-1]))
        tips, start = 0 if closed else _tips(points), float(arc[0]) / length
        yield Row(frame=frame, points=len(points), start=start, ordered=ordered, tips=tips, ms=ms)


def _tips(points: Array) -> int:
    """Return how many of ``(P, 2)`` pixels have exactly one neighbour among them."""
    low = points.min(axis=0).astype(int) - 1
    column, row = (points.astype(int) - low).T
    picture = np.zeros((row.max() + 2, column.max() + 2), np.uint8)
    picture[row, column] = 1
    around = cv2.filter2D(picture, -1, np.ones((3, 3), np.float32), borderType=cv2.BORDER_CONSTANT)
    return int(np.sum(around[row, column] == 2))
