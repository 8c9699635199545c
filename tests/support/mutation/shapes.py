"""Faults in the quality check and in the lift from pixels to metres."""

from __future__ import annotations

from .mutant import Mutant


def _gate(name: str, old: str, new: str, equivalent: str = "") -> Mutant:
    return Mutant(
        f"gate: {name}",
        "shape_obs/tracking/validation.py",
        old,
        new,
        ("tests/tracking/test_validation.py",),
        equivalent,
    )


def _lift(name: str, module: str, old: str, new: str, *tests: str, equivalent: str = "") -> Mutant:
    files = tuple(f"tests/test_{test}.py" for test in tests or ("lift",))
    return Mutant(f"lift: {name}", f"shape_obs/{module}.py", old, new, files, equivalent)


SHAPES: tuple[Mutant, ...] = (
    _gate("a curve may lie off the mask", "    if off > _MAX_OFF:", "    if False:"),
    _gate("a fifth may lie off the mask", "_MAX_OFF: Final = 0.10", "_MAX_OFF: Final = 0.20"),
    _gate("all that is empty counts as hidden", "hidden = min(empty, bridged)", "hidden = empty"),
    _gate("nothing counts as hidden", "hidden = min(empty, bridged)", "hidden = 0.0"),
    _gate("a mask may spread", "    if spread > _MAX_SPREAD:", "    if False:"),
    _gate("a mask may spread twice as far", "_MAX_SPREAD: Final = 0.40", "_MAX_SPREAD: Final = 0.80"),
    _gate("spread within samples is ignored", "(square + body.within) ** 0.5", "square**0.5"),
    _gate("spread is not weighed by area", "body.samples.weight, curve.points)",
          "body.samples.weight**0, curve.points)"),
    _gate("hidden pieces count as width", "body.breadth(curve.size * (1 - hidden))", "body.breadth(curve.size)"),
    _gate("quality ignores what lies off", "(1 - max(off, 0.0) / _MAX_OFF)", "1.0"),
    _gate("quality ignores the spread", "min(max(1 - excess, 0.0), 1.0)", "1.0"),
    _gate("a piece may be small", "    if piece < _MIN_PIECE:", "    if False:"),
    _gate("an outline may miss", "    if miss > _MAX_MISS:", "    if False:"),
    _gate("quality of an outline ignores its miss", "((1 - excess) * piece) ** 0.5", "piece**0.5"),
    _gate("a lattice may lie off", "    if empty > _MAX_OFF:", "    if False:"),
    _gate("a corner may be acute", "    elif abs(corner - 90) > _MAX_SKEW:", "    elif False:"),
    _gate("a lattice may fold", "    elif folds > _MAX_FOLDS:", "    elif False:"),
    _gate("an outline may turn", "    elif kink > _MAX_KINK:", "    elif False:"),
    _gate("a side may wind", "    elif winding > _MAX_WINDING:", "    elif False:"),
    _gate("cells may vary", "    elif uneven > _MAX_UNEVEN:", "    elif False:"),
    _gate("quality of a sheet ignores kinks", "* (1 - bent) *", "*"),
    _lift("a bridged point is visible", "points", "region.carries(points) & ~bridged", "region.carries(points)"),
    _lift("a point off the mask is valid", "points", "valid = visible & np.isfinite(z)", "valid = np.isfinite(z)"),
    _lift("a point without depth is valid", "points", "valid = visible & np.isfinite(z)", "valid = visible.copy()"),
    _lift("a point without a ray is valid", "points", "    valid &= np.isfinite(points3d).all(axis=1)", "    pass",
          "degenerate_input"),
    _lift("holes take no neighbour's depth", "points", "if 0 < np.count_nonzero(valid) < len(valid):", "if False:"),
    _lift("depth beside what hides a piece is the points'", "points",
          "z[np.isnan(under)[np.argmin(cdist(points, form.points), axis=1)]] = np.nan", "pass", "covered", "lift"),
    _lift("depth of what hides a piece is the rope's", "lift", "form.bridged | overlaid(form, z, width)",
          "form.bridged", "covered"),
    _lift("half of a form suffices no more", "lift", "if known.mean() < 0.5:", "if False:", "lift"),
    _lift("a form without rays is measured", "lift", "return points if np.isfinite(points).all() else None",
          "return points", "degenerate_input"),
    _lift("one pixel tells the depth", "lift", "reach = min(max(round(width / 4), 1), _MAX_REACH)", "reach = 0"),
    _lift("one valid pixel suffices", "lift", "_MIN_SHARE: Final = 0.25", "_MIN_SHARE: Final = 0.0", "lift"),
    _lift("the axis lies along z", "lift", "radius / np.linalg.norm(rays, axis=1)", "radius"),
    _lift("the surface is the axis", "lift", "    if radius:", "    if False:"),
    _lift("nan interpolates", "missing", 'if policy == "interpolate" or', "if True or"),
    _lift("hold gives nan", "missing", 'np.nan if policy == "nan" or last is None else last[~valid]', "np.nan"),
    _lift("clouds keep what flies in between", "deproject", "kept = off <= ", "kept = off <= np.inf * 1 + 0 * ",
          "cloud_lift"),
    _lift("clouds keep absurd points", "deproject", "points[plausible]", "points", "degenerate_input"),
    _lift("compiled code reads beyond the image", "kernels/numba_mask", "if -FAR_OFF < at < FAR_OFF else int(-FAR_OFF)",
          "if at == at else int(-FAR_OFF)", "degenerate_input"),
    _lift("NumPy code reads beyond the image", "kernels/numpy_mask", "np.fmin(np.fmax(points, -FAR_OFF), FAR_OFF)",
          "np.maximum(points, -FAR_OFF)", "degenerate_input"),
    _lift("a lens has a ray everywhere", "camera", "found = change < _CONVERGED", "found = change < np.inf",
          "degenerate_input"),
    _lift("arrays of a shape can be written", "shape", "    copy.flags.writeable = False", "    pass", "arrays"),
    _lift("arrays of a shape are the caller's", "shape", "copy = np.array(values, dtype)",
          "copy = np.asarray(values, dtype).view()", "arrays"),
    _lift("copied shapes can be written", "shape", "        self.__post_init__()\n", "", "arrays"),
)  # fmt: skip
