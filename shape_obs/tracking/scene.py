"""What a frame shows around the objects: its images, its time, and the part of it that is searched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.camera import Intrinsics
from shape_obs.frame import DEPTH_TYPE, DepthImages, Frame, depth_images
from shape_obs.geometry.curve import NO_VALUES
from shape_obs.image.region import Region
from shape_obs.image.roi import Window
from shape_obs.tracking.clock import Clock

#: Name -> pixel (u, v) or base-frame point (x, y, z), metres.
Anchors = Mapping[str, Sequence[float]] | None
Box = tuple[int, int, int, int]
#: A mask as a step takes it: ``(h, w)`` uint8; ``(R, 3)`` its runs; how many components there are; three boxes in the
#: image (left, top, width, height): the mask's, that of what is in it, that of what is searched; the frame's depth, see
#: ``frame.depth_images``, both empty without depth or a camera; the projection, see ``Intrinsics.lens``, ``(0,)``
#: without one.
InMask = tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64], int, Box, Box, Box, DepthImages, npt.NDArray[np.float64]]

MASK_TYPE: Final = f"Tuple((u1[:,::1], i8[:,::1], i8, {3 * 'UniTuple(i8, 4), '}{DEPTH_TYPE}, f8[::1]))"
NO_BOX: Final = 0, 0, 0, 0  # without a mask
NO_MASK: Final[InMask] = (  # in a cloud
    np.zeros((0, 0), np.uint8), np.zeros((0, 3), np.int64), 0, NO_BOX, NO_BOX, NO_BOX, depth_images(None), NO_VALUES,
)  # fmt: skip


class Scene(NamedTuple):
    """A frame as all shapes see it.

    Args:
        frame: The images.
        clock: The time now.
        anchors: Where named anchors are.
        in_2d: Whether points get pixels.
        in_3d: Whether points get metres.
        size: ``(H, W)`` in pixels; zeros for a cloud.
        edge: The part of the image that may be searched: an object that touches its edge is cut. None for a cloud.
        depth: ``(H, W)``, None if there is none: it shows what lies over an object.
        intrinsics: Of the camera; None without one, or without depth.
        images: The depth as compiled code reads it; both empty if there is none.
        lens: ``(10,)`` the projection, see ``Intrinsics.lens``; ``(0,)`` without one, or without depth.
    """

    frame: Frame
    clock: Clock
    anchors: Anchors = None
    in_2d: bool = True
    in_3d: bool = False
    size: tuple[int, int] = (0, 0)
    edge: Window | None = None
    depth: npt.NDArray[Any] | None = None
    intrinsics: Intrinsics | None = None
    images: DepthImages = depth_images(None)
    lens: npt.NDArray[np.float64] = NO_VALUES

    @classmethod
    def in_image(
        cls, frame: Frame, clock: Clock, size: tuple[int, int], edge: Window | None, anchors: Anchors = None
    ) -> Scene:
        """Return the scene of images or a mask of ``(H, W)``, in space if there are depth and a camera."""
        if frame.depth is None or frame.camera is None:
            return cls(frame, clock, anchors, True, False, size, edge)
        camera, images = frame.camera.intrinsics, depth_images(frame.depth)
        return cls(frame, clock, anchors, True, True, size, edge, frame.depth, camera, images, camera.lens)

    def in_mask(self, region: Region) -> InMask:
        """Return a mask, and the frame around it, as a step takes them."""
        edge = (self.edge or region.window)[:4]
        own = region.mask, region.runs, region.pieces, region.window[:4], region.box[:4]
        return *own, edge, self.images, self.lens
