"""The reason why a shape was refused, as advice for the person at the page."""

from __future__ import annotations

import re
from typing import Final

from shape_obs.shape import Detection

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
