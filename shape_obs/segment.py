"""From a frame to the region of a pixel rule, the quickest way that gives the same pixels."""

from __future__ import annotations

from typing import Final, TypeGuard

from shape_obs.frame import Frame
from shape_obs.kernels import Kernels
from shape_obs.region import Region, find_region
from shape_obs.roi import ROI, Window
from shape_obs.segmentation import ColourRule, Segmentation
from shape_obs.segmentation.base import need
from shape_obs.segmentation.table import colour_table

# A strand at least so wide, pixels, is not missed where one pixel in step x step is looked at: see ``Kernels.seek``.
_STEPS: Final = ((12.0, 8), (7.0, 4))


def segment(frame: Frame, window: Window, rule: Segmentation, roi: ROI, kernels: Kernels, width: float = 0.0) -> Region:
    """Find the plausible components of a rule's mask in a window.

    A colour rule is looked up in its table where the kernels are fast at that. Where the object is known to be wide,
    not every pixel has to be read: components that hold no disc nearly as wide may then be overlooked, and all others
    are the same to the pixel.

    Args:
        frame: The images.
        window: Where to look.
        rule: Which pixels belong to the object.
        roi: What to blank in the window.
        kernels: What runs the inner loops.
        width: Of the object where it is thinnest, pixels; 0 where it is not known, and nothing is overlooked.
    """
    if not (kernels.reads_tables and _is_compiled(rule)):
        mask = rule.apply(frame, window)
    else:
        rgb, table = need(frame.rgb, "rgb", rule), colour_table(rule)
        step = next((step for least, step in _STEPS if width >= least), 1)
        untouched = max(rule.open, rule.close) <= 1 and type(roi).blank is ROI.blank
        if step > 1 and untouched:
            mask, runs, areas, box = kernels.seek(rgb, window, table, step, rule.min_area, rule.min_share)
            return Region(window, mask, runs, tuple(areas.tolist()), Window(*box), kernels)
        mask = rule.clean(kernels.table_mask(rgb, window, table))
    return find_region(roi.blank(mask, window), window, rule.min_area, rule.min_share, kernels)


def prepare(rule: Segmentation | None, kernels: Kernels) -> None:
    """Make now what the first frame would have to wait for."""
    if kernels.reads_tables and _is_compiled(rule):
        colour_table(rule)


def _is_compiled(rule: Segmentation | None) -> TypeGuard[ColourRule]:
    """Whether a rule is what its table says: a colour rule, and not one that changes what is made of the colours."""
    return (
        isinstance(rule, ColourRule)
        and type(rule).threshold is ColourRule.threshold
        and type(rule).apply is ColourRule.apply
        and type(rule).clean is ColourRule.clean
    )
