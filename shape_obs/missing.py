"""What happens to what was not seen: lost shapes and single points without depth. Both policies live here."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from shape_obs.shape import Shape

OnMissing = Literal["hold", "truncate", "raise", "nan"]
OnInvalid = Literal["interpolate", "hold", "nan"]


class ShapeLostError(RuntimeError):
    """A shape was not found and ``on_missing="raise"`` was asked for; the message says why it was not."""


def lost_shape(
    name: str,
    count: int,
    *,
    reason: str,
    in_3d: bool,
    last: Shape | None,
    age: float,
    max_age: float,
    policy: OnMissing,
) -> Shape:
    """What stands in for a shape that was not found.

    ``"hold"`` repeats the last points and stays ok for ``max_age`` seconds; ``"truncate"`` repeats them too, never ok
    (the wrapper ends the episode); ``"nan"`` forgets them; ``"raise"`` raises. No point is visible or valid.

    Args:
        name: The configuration's name.
        count: N.
        reason: Why it was not found.
        in_3d: Whether points3d are wanted.
        last: The shape when it was last found.
        age: Seconds since then.
        max_age: See above.
        policy: See above.

    Raises:
        ShapeLostError: With ``policy="raise"``.
    """
    if policy == "raise":
        raise ShapeLostError(f"shape {name!r} was not found: {reason}")
    nobody = np.zeros(count, bool)
    nowhere = np.full((count, 3), np.nan, np.float32) if in_3d else None
    if last is None or policy == "nan":
        return Shape(
            name,
            np.full((count, 2), np.nan, np.float32),
            nowhere,
            visible=nobody,
            valid=nobody.copy(),
            ok=False,
            quality=0.0,
            reason=reason,
            age=age,
        )
    return replace(
        last,
        points2d=last.points2d.copy(),
        points3d=nowhere if last.points3d is None else last.points3d.copy(),
        visible=nobody,
        valid=nobody.copy(),
        ok=policy == "hold" and age <= max_age,
        quality=0.0,
        reason=reason,
        age=age,
    )


def fill_invalid(
    points3d: npt.NDArray[np.float32], last: npt.NDArray[np.float32] | None, policy: OnInvalid
) -> npt.NDArray[np.float32]:
    """Fill points without depth; they stay ``valid=False`` whatever fills them.

    Args:
        points3d: (N,3) metres, NaN where unknown.
        last: (N,3) of the last frame, for ``"hold"``.
        policy: ``"interpolate"`` along the index (the points are equidistant), ends repeated; ``"hold"`` the last
            frame's; ``"nan"`` leaves them.

    Returns:
        (N,3); NaN where the policy has nothing to fill from.
    """
    unknown = ~np.isfinite(points3d).all(axis=1)
    if policy == "nan" or not unknown.any():
        return points3d
    filled = points3d.copy()
    if policy == "hold":
        if last is not None:
            filled[unknown] = last[unknown]
    elif not unknown.all():
        at = np.arange(len(points3d))
        for d in range(3):
            filled[unknown, d] = np.interp(at[unknown], at[~unknown], points3d[~unknown, d])
    return filled
