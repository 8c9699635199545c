"""Which pixels of a frame match the segmentation of a detector, to be shown to people."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.detector import ShapeDetector
from shape_obs.frame import Frame
from shape_obs.image.roi import ROI, Whole, Window
from shape_obs.image.segmentation import ColourRule, DepthRange


def matching_pixels(frame: Frame, detector: ShapeDetector) -> npt.NDArray[np.bool_] | None:
    """Return the pixels that match the rules of any shape, within the region of interest, of shape ``(H, W)``.

    Small components, which the detector drops, are included. A region of interest that moves is left out. Only colour
    and depth are looked up: a rule that runs a model is not run a second time.

    Returns:
        None if no rule can be looked up.
    """
    size, roi = frame.size, detector.config.roi
    rules = {id(spec.segmentation): spec.segmentation for spec in detector.shapes}.values()
    usable = [
        rule
        for rule in rules
        if (isinstance(rule, ColourRule) and frame.rgb is not None)
        or (isinstance(rule, DepthRange) and frame.depth is not None)
    ]
    if size is None or not usable:
        return None
    still: ROI = roi if roi is not None and type(roi).place is ROI.place else Whole()
    window: Window = still.window(size)
    mask = np.zeros(size, bool)
    for rule in usable:
        mask[window.slices] |= still.blank(rule.apply(frame, window), window) > 0
    return mask
