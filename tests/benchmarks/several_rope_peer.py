"""Find several ropes as the best peer does: thinning, junctions clustered by DBSCAN, branches paired by least bending.

Written from the description in Choi et al. (2023), "mBEST: Realtime Deformable Linear Object Detection Through Minimal
Bending Energy Skeleton Pixel Traversals". It needs scikit-image and scikit-learn.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import combinations
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Pixel = tuple[int, int]
_SPREAD: Final = 3.0  # pixels between junction pixels of one cluster
# In widths of the ropes:
_SPUR: Final = 1.0  # the longest branch from a junction to a free end that is pruned
_MERGED: Final = 3.0  # the longest branch between two junctions of three arms that are one crossing
_STEM: Final = 9.0  # the same if the other arms go on within 60 degrees of its direction, at both ends
_LOOK: Final = 2.5  # length of the arms whose bending is compared
_SHORTEST: Final = 4.0  # the shortest rope
_KERNEL: Final = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.float32)


@dataclass(eq=False)
class _Branch:
    """A chain of skeleton pixels, ``(P, 2)`` (u, v), and the junction at each of its two ends; -1 for a free end."""

    pixels: Array
    nodes: list[int]


def is_installed() -> bool:
    """Return whether scikit-image and scikit-learn are installed."""
    return find_spec("skimage") is not None and find_spec("sklearn") is not None


def peer_ropes(mask: npt.NDArray[np.uint8]) -> list[Array]:
    """Return the axis of each rope in a mask, ``(P, 2)`` pixels, from tip to tip in steps of about a pixel.

    Args:
        mask: ``(H, W)`` uint8, 0 or 255; specks and ragged borders are smoothed first.
    """
    from skimage.morphology import skeletonize

    smooth = cv2.threshold(cv2.GaussianBlur(mask, (5, 5), 0), 127, 255, cv2.THRESH_BINARY)[1]
    skeleton = np.asarray(skeletonize(smooth > 0))
    if not skeleton.any():
        return []
    width = 2.0 * float(np.median(cv2.distanceTransform(smooth, cv2.DIST_L2, 5)[skeleton]))
    branches = _branches(skeleton)
    for _ in range(2):
        branches = _joined([branch for branch in branches if not _is_spur(branch, width)])
    branches = _merged(branches, width)
    paths = _traversed(branches, width)
    return [path for path in paths if np.linalg.norm(np.diff(path, axis=0), axis=1).sum() >= _SHORTEST * width]


def _branches(skeleton: npt.NDArray[np.bool_]) -> list[_Branch]:
    """Split a skeleton at its junctions: pixels with three neighbours or more, clustered by DBSCAN."""
    from sklearn.cluster import DBSCAN

    image = skeleton.astype(np.float32)
    junctions = skeleton & (cv2.filter2D(image, -1, _KERNEL, borderType=cv2.BORDER_CONSTANT) >= 3)
    node_of: dict[Pixel, int] = {}
    places = np.argwhere(junctions)
    if len(places):
        labels = DBSCAN(eps=_SPREAD, min_samples=1).fit_predict(places)
        node_of = {(int(row), int(column)): int(label) for (row, column), label in zip(places, labels, strict=True)}
    left = {(int(row), int(column)) for row, column in np.argwhere(skeleton & ~junctions)}
    branches = []
    while left:
        start = left.pop()
        chain = [start, *_walk(start, left)]
        chain = [*list(_walk(start, left))[::-1], *chain]
        ends = [next((node_of[p] for p in _around(chain[k]) if p in node_of), -1) for k in (0, -1)]
        if len(chain) == 1:
            nodes = list(dict.fromkeys(node_of[p] for p in _around(chain[0]) if p in node_of))
            ends = (nodes + [-1, -1])[:2]
        branches.append(_Branch(np.array(chain, dtype=np.float64)[:, ::-1], ends))
    return branches


def _walk(pixel: Pixel, left: set[Pixel]) -> Iterator[Pixel]:
    """Yield the pixels from one on, and take them away from those that are left."""
    while True:
        step = next((p for p in _around(pixel) if p in left), None)
        if step is None:
            return
        left.remove(step)
        yield step
        pixel = step


def _around(pixel: Pixel) -> list[Pixel]:
    """Return the eight neighbours of a pixel, the nearest four first."""
    v, u = pixel
    diagonal = [(v - 1, u - 1), (v - 1, u + 1), (v + 1, u - 1), (v + 1, u + 1)]
    return [(v - 1, u), (v, u - 1), (v, u + 1), (v + 1, u), *diagonal]


def _is_spur(branch: _Branch, width: float) -> bool:
    return min(branch.nodes) < 0 <= max(branch.nodes) and len(branch.pixels) < _SPUR * width


def _arms(branches: list[_Branch]) -> dict[int, list[tuple[_Branch, int]]]:
    """Return the branches at each junction, each with the end that lies there."""
    arms: dict[int, list[tuple[_Branch, int]]] = {}
    for branch in branches:
        for end in range(2):
            if branch.nodes[end] >= 0:
                arms.setdefault(branch.nodes[end], []).append((branch, end))
    return arms


def _joined(branches: list[_Branch]) -> list[_Branch]:
    """Join the two branches of each junction that has no more than two."""
    while True:
        pair = next((arms for arms in _arms(branches).values() if len(arms) <= 2), [])
        if not pair:
            return branches
        if len(pair) == 1 or pair[0][0] is pair[1][0]:
            for branch, end in pair:
                branch.nodes[end] = -1
            continue
        (one, end), (other, start) = pair
        first = one.pixels if end == 1 else one.pixels[::-1]
        second = other.pixels if start == 0 else other.pixels[::-1]
        joined = _Branch(np.concatenate([first, second]), [one.nodes[1 - end], other.nodes[1 - start]])
        branches = [branch for branch in branches if branch is not one and branch is not other] + [joined]


def _merged(branches: list[_Branch], width: float) -> list[_Branch]:
    """Merge junctions of three arms at both ends of a short branch: two strands run through it."""
    while True:
        arms = _arms(branches)
        short = [
            branch
            for branch in branches
            if min(branch.nodes) >= 0
            and branch.nodes[0] != branch.nodes[1]
            and all(len(arms[node]) == 3 for node in branch.nodes)
            and (len(branch.pixels) < _MERGED * width or _is_stem(branch, arms, width))
        ]
        if not short:
            return branches
        gone = min(short, key=lambda branch: len(branch.pixels))
        branches = [branch for branch in branches if branch is not gone]
        for branch in branches:
            branch.nodes = [gone.nodes[0] if node == gone.nodes[1] else node for node in branch.nodes]


def _is_stem(branch: _Branch, arms: dict[int, list[tuple[_Branch, int]]], width: float) -> bool:
    """Return whether two strands run together along a branch: they come from behind it, and go on ahead."""
    if len(branch.pixels) > _STEM * width:
        return False
    reach = max(round(_LOOK * width), 4)
    for end, node in enumerate(branch.nodes):
        ahead = branch.pixels[-1 if end else 0] - branch.pixels[0 if end else -1]
        for other, start in arms[node]:
            if other is branch:
                continue
            way = (other.pixels if start == 0 else other.pixels[::-1])[:reach]
            along = way[-1] - way[0]
            if along @ ahead < 0.5 * np.linalg.norm(along) * np.linalg.norm(ahead):
                return False
    return True


def _traversed(branches: list[_Branch], width: float) -> list[Array]:
    """Walk from every free end through the junctions to another free end."""
    onward: dict[tuple[int, int], tuple[_Branch, int]] = {}
    for arms in _arms(branches).values():
        for one, other in _pairs(arms, width):
            onward[id(one[0]), one[1]], onward[id(other[0]), other[1]] = other, one
    paths, used = [], set()
    for first in branches:
        for start in range(2):
            if (id(first), start) in onward or id(first) in used:
                continue
            branch, end, pieces = first, start, []
            while id(branch) not in used:
                used.add(id(branch))
                pieces.append(branch.pixels if end == 0 else branch.pixels[::-1])
                following = onward.get((id(branch), 1 - end))
                if following is None:
                    break
                branch, end = following
            paths.append(np.concatenate(pieces))
    return paths


def _pairs(arms: list[tuple[_Branch, int]], width: float) -> list[tuple[Any, Any]]:
    """Return the pairing of a junction's arms with the least cumulative bending energy; one may be left over."""
    reach = max(round(_LOOK * width), 4)
    ways = [branch.pixels[:reach] if end == 0 else branch.pixels[::-1][:reach] for branch, end in arms]
    energy = {(i, j): _energy(ways[i], ways[j]) for i, j in combinations(range(len(arms)), 2)}
    best = min(_matchings(tuple(range(len(arms)))), key=lambda pairs: sum(energy[pair] for pair in pairs))
    return [(arms[i], arms[j]) for i, j in best]


def _matchings(indices: tuple[int, ...]) -> Iterator[list[tuple[int, int]]]:
    """Yield all ways to pair indices; of an odd number one is left over."""
    if len(indices) < 2:
        yield []
        return
    if len(indices) % 2:
        for k in range(len(indices)):
            yield from _matchings(indices[:k] + indices[k + 1 :])
        return
    first, *rest = indices
    for k, other in enumerate(rest):
        for pairs in _matchings(tuple(rest[:k] + rest[k + 1 :])):
            yield [(first, other), *pairs]


def _energy(one: Array, other: Array) -> float:
    """Return the bending energy of a path along two arms: squared turns over steps, between points 5 pixels apart."""
    path = np.concatenate([one[::-1], other])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0, arc[-1], max(round(arc[-1] / 5), 3))
    points = np.stack([np.interp(at, arc, path[:, d]) for d in range(2)], axis=1)
    step = np.diff(points, axis=0)
    heading = np.arctan2(step[:, 1], step[:, 0])
    turn = np.angle(np.exp(1j * np.diff(heading)))
    return float((turn**2).sum() / max(at[1], 1e-9))
