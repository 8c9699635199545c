"""Faults in the quality check and in the lift from pixels to metres."""

from __future__ import annotations

from .mutant import Mutant

_LIFTING = "tests/point_cloud/test_lifting.py"
_DEGENERATE = "tests/test_degenerate_input.py"
_OCCLUDERS = "tests/tracking/test_occluders.py"
_ARRAYS = "tests/utils/test_arrays.py"


def _valid(name: str, old: str, new: str, module: str = "tracking/validation", equivalent: str = "") -> Mutant:
    tests = ("tests/tracking/test_validation.py",)
    return Mutant(f"validation: {name}", f"shape_obs/{module}.py", old, new, tests, equivalent)


def _lift(name: str, module: str, old: str, new: str, *tests: str, equivalent: str = "") -> Mutant:
    return Mutant(f"lift: {name}", f"shape_obs/{module}.py", old, new, tests or (_LIFTING,), equivalent)


def _points(name: str, old: str, new: str, *tests: str) -> Mutant:
    return _lift(name, "configurations/points_in_image", old, new, *tests)


SHAPES: tuple[Mutant, ...] = (
    _valid("a curve may lie off the mask", "    if off > _MAX_OFF:\n        return", "    if False:\n        return"),
    _valid("a fifth may lie off the mask", "_MAX_OFF: Final = 0.10", "_MAX_OFF: Final = 0.20"),
    _valid("all that is empty counts as hidden", "hidden = min(unsupported, expected_off)", "hidden = unsupported"),
    _valid("nothing counts as hidden", "hidden = min(unsupported, expected_off)", "hidden = 0.0"),
    _valid("a mask may spread", "    if ratio > _MAX_SPREAD:", "    if False:"),
    _valid("a mask may spread twice as far", "_MAX_SPREAD: Final = 0.40", "_MAX_SPREAD: Final = 0.80"),
    _valid("spread within samples is ignored", "spread + min(cell, width) ** 2 / 12", "spread",
           "configurations/centerline"),
    _valid("spread is not weighed by area", "total += weight[m * step] * max(",
           "total += max("),
    _valid("hidden pieces count as width", "float(curve.arc[-1]) * (1 - hidden)", "float(curve.arc[-1])"),
    _valid("quality ignores what lies off", "(1 - max(off, 0.0) / _MAX_OFF)", "1.0"),
    _valid("quality ignores the spread", "min(max(1 - excess, 0.0), 1.0)", "1.0"),
    _valid("a piece may be small", "    if piece < _MIN_PIECE:", "    if False:"),
    _valid("an outline may miss", "    if miss > _MAX_MISS:", "    if False:"),
    _valid("quality of an outline ignores its miss", "((1 - excess) * piece) ** 0.5", "piece**0.5"),
    _valid("a lattice may lie off", "    elif off > _MAX_OFF:\n        reason", "    elif False:\n        reason"),
    _valid("a corner may be acute", "    elif abs(corner - 90) > _MAX_SKEW:", "    elif False:"),
    _valid("a lattice may fold", "    elif folds > _MAX_FOLDS:", "    elif False:"),
    _valid("an outline may turn", "    elif kink > _MAX_KINK:", "    elif False:"),
    _valid("a side may wind", "    elif winding > _MAX_WINDING:", "    elif False:"),
    _valid("cells may vary", "    elif uneven > _MAX_UNEVEN:", "    elif False:"),
    _valid("quality of a sheet ignores kinks", "* (1 - bent) *", "*"),
    _lift("an interpolated point without depth is visible", "configurations/shape_points",
          "region.carries(points) & ~interpolated", "region.carries(points)"),
    _points("an interpolated point over depth is visible",
            "            visible[n] = visible[n] and not interpolated[n]\n            valid",
            "            valid"),
    _points("a point off the mask is valid", "visible[n] and math.isfinite(z[n])", "math.isfinite(z[n])"),
    _points("a point without depth is valid", "visible[n] and math.isfinite(z[n])", "visible[n]"),
    _points("a point without a ray is valid", "valid[n] and math.isfinite(found[n, d])", "valid[n]",
            _DEGENERATE),
    _lift("holes take no neighbour's depth", "configurations/shape_points", "        if known.any():\n",
          "        if False:\n"),
    _lift("depth next to what hides a piece is the points'", "configurations/shape_points",
          "        valid &= ~unknown\n", "", _OCCLUDERS, _LIFTING),
    _points("one pixel gives the depth of a point", "min(max(int(np.rint(width / 4)), 1), MAX_REACH)", "0"),
    _points("the axis lies along z", "radius / length", "radius"),
    _points("the surface is the axis", "(z[n] + radius / length)", "z[n]"),
    _lift("depth of what hides a piece is the rope's", "point_cloud/lifting",
          "form.interpolated | overlaid(form, z, width)", "form.interpolated", _OCCLUDERS),
    _lift("half of a form suffices no more", "point_cloud/lifting", "if known.mean() < 0.5:", "if False:"),
    _lift("a form without rays is measured", "point_cloud/lifting",
          "return points if np.isfinite(points).all() else None", "return points", _DEGENERATE),
    _lift("one pixel gives the depth of a form", "point_cloud/lifting",
          "reach = min(max(round(width / 4), 1), MAX_REACH)", "reach = 0"),
    _lift("one valid pixel suffices", "point_cloud/local_depth", "MIN_SHARE: Final = 0.25", "MIN_SHARE: Final = 0.0"),
    _lift("nan interpolates", "tracking/missing", 'if policy == "interpolate":', "if True:"),
    _lift("hold gives nan", "tracking/missing", 'np.nan if policy == "nan" or last is None else last[~valid]',
          "np.nan"),
    _lift("clouds keep what flies in between", "point_cloud/deprojection", "kept = off <= ",
          "kept = off <= np.inf * 1 + 0 * ", "tests/point_cloud/test_cloud_lift.py"),
    _lift("clouds keep absurd points", "point_cloud/deprojection", "points[plausible]", "points", _DEGENERATE),
    _lift("compiled code reads beyond the image", "image/connected_runs",
          "if -_FAR_OFF < at < _FAR_OFF else int(-_FAR_OFF)", "if at == at else int(-_FAR_OFF)", _DEGENERATE),
    _lift("NaN becomes a pixel", "image/connected_runs", "if -_FAR_OFF < at < _FAR_OFF else int(-_FAR_OFF)",
          "if not abs(at) >= _FAR_OFF else int(-_FAR_OFF)", _DEGENERATE),
    _lift("a lens has a ray everywhere", "camera", "found = change < _CONVERGED", "found = change < np.inf",
          _DEGENERATE),
    _lift("arrays of a shape can be written", "shape", "            values.flags.writeable = False",
          "            pass", _ARRAYS),
    _lift("arrays of a shape are the caller's", "shape", "values = np.array(values, dtype)",
          "values = np.asarray(values, dtype).view()", _ARRAYS),
    _lift("copied shapes can be written", "shape", "        self.__post_init__()\n", "", _ARRAYS),
)  # fmt: skip
