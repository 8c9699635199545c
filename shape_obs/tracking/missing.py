"""Policies for what was not seen: lost shapes and single points without depth."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.topology import Topology
from shape_obs.shape import Shape
from shape_obs.tracking.belief import MAX_SIGMA, aged

OnMissing = Literal["hold", "truncate", "raise", "nan"]
OnInvalid = Literal["interpolate", "hold", "nan"]


class ShapeLostError(RuntimeError):
    """A shape was not found and ``on_missing="raise"`` was asked for; the message says why it was not."""


def lost_shape(
    name: str,
    layout: Topology,
    *,
    reason: str,
    in_2d: bool,
    in_3d: bool,
    last: Shape | None,
    age: float,
    held: bool,
    policy: OnMissing,
    diagonal: float,
) -> Shape:
    """Return the shape that stands in for one that was not found.

    ``"hold"`` repeats the last points, which stay ok while they are ``held``; ``"truncate"`` repeats them too, never ok
    (the wrapper ends the episode); ``"nan"`` forgets them; ``"raise"`` raises. No point is visible or valid, and
    ``sigma`` grows with age up to its bound; it is the bound where no points are known.

    Args:
        name: The configuration's name.
        layout: How its N points are connected.
        reason: Why it was not found.
        in_2d: Whether points2d are wanted.
        in_3d: Whether points3d are wanted.
        last: The shape when it was last found.
        age: Seconds since then.
        held: Whether its last points may still be used: they are young enough, and do not lie off what is seen of it.
        policy: See above.
        diagonal: Of the image, pixels: the bound of ``sigma`` in pixels.

    Raises:
        ShapeLostError: With ``policy="raise"``.
    """
    if policy == "raise":
        raise ShapeLostError(f"shape {name!r} was not found: {reason}")
    no_point = np.zeros(layout.size, bool)
    was_found, sigma = last is not None, np.full(layout.size, np.inf, np.float32)
    if last is None or policy == "nan":
        pixels = np.full((layout.size, 2), np.nan, np.float32) if in_2d else None
        number, length = (0, None) if last is None else (last.track_id, last.length)
        last = Shape(name, pixels, None, no_point, no_point, layout, track_id=number, length=length)
    elif last.points3d is not None or not in_3d:  # else it is in pixels, and nothing is known in space
        sigma = last.sigma
    points3d = last.points3d
    if points3d is None and in_3d:
        points3d = np.full((layout.size, 3), np.nan, np.float32)
    sigma = aged(sigma, age, diagonal if points3d is None else MAX_SIGMA)
    ok = policy == "hold" and held and was_found
    return replace(
        last, points3d=points3d, visible=no_point, valid=no_point, ok=ok, quality=0.0, reason=reason, age=age,
        sigma=sigma, new=False,
    )  # fmt: skip


def fill_invalid(
    expected: npt.NDArray[np.float32],
    valid: npt.NDArray[np.bool_],
    last: npt.NDArray[np.float32] | None,
    policy: OnInvalid,
) -> npt.NDArray[np.float32]:
    """Fill in points without depth; they stay ``valid=False``.

    Args:
        expected: ``(N, 3)`` metres: valid points, and where the others should be.
        valid: ``(N,)`` bool.
        last: ``(N, 3)`` of the last frame, for ``"hold"``.
        policy: ``"interpolate"`` takes what is expected (in an image, the point's own ray at the depth of its
            neighbours; in a cloud, its place on the form); ``"hold"`` the last frame's; ``"nan"`` nothing.

    Returns:
        ``(N, 3)``; NaN where the policy has nothing to fill with.
    """
    if policy == "interpolate":
        return expected
    points3d = expected.copy()
    points3d[~valid] = np.nan if policy == "nan" or last is None else last[~valid]
    return points3d
