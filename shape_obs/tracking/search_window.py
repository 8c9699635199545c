"""Search windows: look for the region of each pixel rule near where the track expects it, else everywhere."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame
from shape_obs.geometry.topology import Chain, Ring
from shape_obs.image.find_region import cut_region, find_region, segment
from shape_obs.image.mask_check import checked_mask
from shape_obs.image.region import Region
from shape_obs.image.roi import ROI, Window
from shape_obs.image.segmentation import Expected, FollowingRule, Segmentation
from shape_obs.tracking.predict import Track

if TYPE_CHECKING:
    from shape_obs.point_cloud.deprojection import SeenCloud

_SPARE: Final = 8  # pixels around the place where a mask is expected
_CONTEXT: Final = 32  # pixels around the window that a rule that follows the track sees
_TURNED: Final = 0.5  # rad by which an object may turn in a frame, about, or the share by which it may stretch
_PLACES: Final = 24  # in an outline, about
_RIM: Final = 7  # pixels of the square around a place in an outline that must be in it too


def predict_search_window(tracks: list[Track | None], spare: int, whole: Window) -> tuple[Window, float] | None:
    """Predict where a mask that several shapes share should be; None if that is not known for one of them.

    What a hand hides may come back anywhere.

    Args:
        tracks: Of the shapes.
        spare: Pixels around them, to which those for what is not foreseen are added.
        whole: The part of the image that is searched.

    Returns:
        A window that holds all of them, its columns in groups of eight, which compiled code reads at once; the width of
        the object where it is thinnest, pixels, 0 if it is not known.
    """
    left = top = thinnest = math.inf
    right = bottom = -math.inf
    for track in tracks:
        if track is None:
            return None
        state, (x, y, width, height) = track.state, track.state["box"][0].tolist()
        if not width or (isinstance(track.topology, Chain) and state["hides"][0]):
            return None
        around, thinnest = spare + _SPARE + int(state["box_motion"][0]), min(thinnest, float(state["width"][0]))
        left, top = min(left, x - around), min(top, y - around)
        right, bottom = max(right, x + width + around), max(bottom, y + height + around)
    left, right = max(left // 8 * 8, whole.left), min(-(-right // 8) * 8, whole.left + whole.width)
    top, bottom = max(top, whole.top), min(bottom, whole.top + whole.height)
    if left >= right or top >= bottom:
        return whole, thinnest
    return Window(int(left), int(top), int(right - left), int(bottom - top)), thinnest


@dataclass
class RegionSearch:
    """The regions found in one frame so far, one for each pixel rule.

    Args:
        frame: The images.
        mask: ``(H, W)`` uint8 where someone else has segmented; None where the rules do.
        roi: The region of interest.
        whole: The part of the image that it reads; what touches its edge may go on behind it.
        tracks: The tracks of the shapes of each rule; a rule of which a shape has none is looked for everywhere.
        everywhere: Whether to look for all of them everywhere; a rule that follows the track still gets it.

    Attributes:
        masks: The masks of the rules that read the whole image, without their clean-up.
    """

    frame: Frame
    mask: npt.NDArray[np.uint8] | None
    roi: ROI
    whole: Window
    tracks: dict[Segmentation | None, list[Track | None]] = field(default_factory=dict)
    everywhere: bool = False
    regions: dict[Segmentation | None, Region] = field(default_factory=dict)
    clouds: dict[Segmentation | None, SeenCloud] = field(default_factory=dict)
    masks: dict[Segmentation, npt.NDArray[np.uint8]] = field(default_factory=dict)

    def region(self, rule: Segmentation | None) -> Region:
        """Return the region of a rule, looked for where it is expected; what runs out of there, everywhere."""
        if rule in self.regions:
            return self.regions[rule]
        frame, whole, tracks = self.frame, self.whole, self.tracks.get(rule, [None])
        reach = 1 if rule is None else 1 + rule.open + rule.close
        follows = isinstance(rule, FollowingRule) and None not in tracks
        spare = _CONTEXT if follows else reach
        expected = None if self.everywhere else predict_search_window(tracks, spare, whole)
        # A rule that follows the object is given its track also where a hand may hide more of it than is known.
        near = self._expected(tracks, expected is None) if follows else None
        if expected is None and not follows:
            self.tracks.pop(rule, None)
        window, width = expected or (whole, 0.0)
        if self.mask is None:
            assert rule is not None
            if rule.whole_image:
                region = cut_region(self.whole_mask(rule), window, rule, self.roi)
            else:
                region = segment(frame, window, rule, self.roi, width, near)
        else:
            floor, mask = rule or Segmentation, self.roi.blank(self.mask[window.slices], window)
            region = find_region(mask, window, floor.min_area, floor.min_share)
        self.regions[rule] = region
        if rule in self.tracks and (not region.areas or _is_cut(region.box, reach, window, whole)):
            self.widen(rule)
            return self.region(rule)
        return region

    def whole_mask(self, rule: Segmentation) -> npt.NDArray[np.uint8]:
        """Return the mask of the whole image; rules that differ only in their clean-up share it."""
        assert self.frame.size is not None
        bare = replace(rule, open=0, close=0, min_area=1, min_share=0.0)
        if bare not in self.masks:
            height, width = self.frame.size
            found = rule.threshold(self.frame, Window(0, 0, width, height))
            self.masks[bare] = checked_mask(found, self.frame.size, rule.label)
        return self.masks[bare]

    def _expected(self, tracks: Iterable[Track | None], anywhere: bool) -> Expected:
        """Return where tracks expect their objects: where these were, and where they should be by now."""
        assert self.frame.size is not None
        known = [track for track in tracks if track is not None]
        mask, places = np.zeros(self.frame.size, np.uint8), []
        for track in known:
            moved = track.nodes + track.interval * track.velocity  # (K, D)
            before, after = (np.diff(nodes[track.topology.edges()], axis=1) for nodes in (track.nodes, moved))
            # Nodes that drifted along the object, or whose order was reversed, show no motion of it.
            plausible = np.linalg.norm(after - before) <= _TURNED * np.linalg.norm(before)
            for nodes in (track.nodes, moved) if plausible else (track.nodes,):
                if nodes.shape[1] == 3 and self.frame.camera is not None:
                    nodes = self.frame.camera.intrinsics.project(nodes)
                places.append(draw_expected(mask, nodes, track))
        ropes = all(isinstance(track.topology, Chain) for track in known)
        return Expected(np.concatenate(places), mask, ropes, anywhere)

    def cloud(self, rule: Segmentation | None) -> SeenCloud:
        """Return the points under the region of a rule; the frame must have depth and a camera."""
        from shape_obs.point_cloud.deprojection import deproject  # most detectors see no clouds

        if rule not in self.clouds:
            assert self.frame.depth is not None
            assert self.frame.camera is not None
            self.clouds[rule] = deproject(self.region(rule), self.frame.depth, self.frame.camera.intrinsics)
        return self.clouds[rule]

    def widen(self, rule: Segmentation | None) -> bool:
        """Look for a rule everywhere from now on; return False if that has been done."""
        if self.tracks.pop(rule, None) is None:
            return False
        self.regions.pop(rule, None)
        self.clouds.pop(rule, None)
        return True


def draw_expected(mask: npt.NDArray[np.uint8], nodes: npt.NDArray[np.float64], track: Track) -> npt.NDArray[np.float64]:
    """Add a shape with nodes at ``(K, 2)`` pixels to a mask: a ribbon, an outline's inside, or a lattice's cells.

    Returns:
        Places in the object, ``(N, 2)`` pixels: the nodes, or what is inside an outline.
    """
    ends = nodes[track.topology.edges()]  # (E, 2, 2)
    corners = np.round(16 * ends).astype(np.int32)
    if isinstance(track.topology, Ring):
        inside = np.zeros_like(mask)
        cv2.fillPoly(inside, [np.ascontiguousarray(corners[:, 0])], (1,), shift=4)
        mask |= inside
        step = max(math.isqrt(np.count_nonzero(inside) // _PLACES), 1)
        rows = cv2.erode(inside, np.ones((_RIM, _RIM), np.uint8))[step // 2 :: step, step // 2 :: step]
        return np.argwhere(rows)[:, ::-1].astype(np.float64) * step + step // 2
    long = float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
    thick = track.width if isinstance(track.topology, Chain) and track.nodes.shape[1] == 2 else long
    cv2.polylines(mask, list(corners), False, (1,), max(round(thick), 1), shift=4)
    return nodes


def _is_cut(box: Window, reach: int, window: Window, whole: Window) -> bool:
    """Return whether a box comes nearer than ``reach`` to an edge of the window beyond which there is more to see."""
    right, bottom = window.left + window.width, window.top + window.height
    return (
        (box.left < window.left + reach and window.left > whole.left)
        or (box.top < window.top + reach and window.top > whole.top)
        or (box.left + box.width > right - reach and right < whole.left + whole.width)
        or (box.top + box.height > bottom - reach and bottom < whole.top + whole.height)
    )
