"""Faults in how ropes are followed through space, and under what hides them."""

from __future__ import annotations

from .mutant import Mutant

_CLAIMS = "tests/bench/test_motion_claims.py"
_LENGTH = "tests/point_cloud/test_chain_length.py"
_OCCLUDERS = "tests/tracking/test_occluders.py"
_OCCLUSION = "tests/tracking/test_occlusion.py"
_PREDICTED = "tests/tracking/test_predicted_rope.py"
_PREDICTION = "tests/tracking/test_prediction.py"
_SPACE = "tests/tracking/test_ropes_in_space.py"


def _rope(name: str, module: str, old: str, new: str, *tests: str) -> Mutant:
    return Mutant(f"rope: {name}", f"shape_obs/{module}.py", old, new, tests or (_SPACE,))


ROPES: tuple[Mutant, ...] = (
    _rope(
        "its place in depth is not compared",
        "tracking/predicted_rope",
        "self.lifted = prediction.relief is not None and (form",
        "self.lifted = False and (form",
        _SPACE,
        _CLAIMS,
    ),
    _rope(
        "what was folded back tells its direction",
        "tracking/predicted_rope",
        "seen = (at >= head) & (at <= 1 - tail)",
        "seen = np.ones(len(at), bool)",
    ),
    _rope(
        "predictions never grow old",
        "tracking/prediction",
        "relief, max(lapse, 1.0), motion)",
        "relief, 1.0, motion)",
        _PREDICTION,
    ),
    _rope(
        "predictions are as good in every track",
        "tracking/rope_match",
        "    residuals = settled(residuals, bent, apart)\n",
        "",
        _SPACE,
        _CLAIMS,
    ),
    _rope(
        "its direction is never in doubt",
        "tracking/predicted_rope",
        "_SURE: Final = 8.0",
        "_SURE: Final = 0.0",
        _SPACE,
        _CLAIMS,
        _PREDICTED,
    ),
    _rope(
        "depth does not move on",
        "tracking/prediction",
        "relief = relief + _VELOCITY_SHARE",
        "relief = relief + 0",
        _PREDICTION,
    ),
    _rope(
        "strands are not parted in a square",
        "point_cloud/strands",
        "far = known and metres > behind * sums[into, 5]",
        "far = False",
        "tests/point_cloud/test_lifting.py",
    ),
    _rope(
        "the map is flat",
        "configurations/centerline",
        "_NOTHING if relief is None or camera is None else relief",
        "_NOTHING",
        _SPACE,
        _CLAIMS,
    ),
    _rope(
        "depth of another strand is its own",
        "point_cloud/strands",
        "low, high, share = expected[n] * (1 - slack) / unit, expected[n] * (1 + slack) / unit, 0.0",
        "share = 0.0",
        _SPACE,
        _CLAIMS,
    ),
    _rope(
        "a smooth depth may lie behind the camera",
        "point_cloud/chain_length",
        "smooth[p] = min(max(smooth[p], least / 2), 2 * most)",
        "pass",
        _LENGTH,
    ),
    _rope(
        "depth is not smoothed",
        "point_cloud/chain_length",
        "            w = 2 * variance /",
        "            w = 1e-6 * variance /",
        "tests/point_cloud/test_chain_length.py",
    ),
    _rope(
        "depth counts at the point, not where it was measured",
        "point_cloud/chain_length",
        "p + _ahead(points, p, places[p]) / step",
        "float(p)",
        "tests/point_cloud/test_chain_length.py",
    ),
    _rope(
        "a spline swings out under a bridged piece",
        "point_cloud/chain_length",
        "    _bridge(clean, bridged)\n",
        "",
        "tests/point_cloud/test_chain_length.py",
    ),
    _rope(
        "a tip that points at the camera is free",
        "tracking/rope_match",
        "_POINTING: Final = 3.0",
        "_POINTING: Final = 99.0",
        _SPACE,
        _CLAIMS,
    ),
    _rope(
        "a strand under another is visible",
        "configurations/shape_points",
        "not interpolated[n] and not under[n]",
        "not interpolated[n]",
    ),
    _rope(
        "depth is compared with the nearest strand's",
        "configurations/shape_points",
        "form.relief is not None and relief is None:",
        "form.relief is not None:",
    ),
    _rope(
        "a point that is seen end-on is valid",
        "configurations/shape_points",
        "_END_ON: Final = 2.4",
        "_END_ON: Final = 99.0",
    ),
    _rope("a rope that is seen end-on is found", "configurations/centerline", "steep > _END_ON:", "False:"),
    _rope(
        "a length is sure where it is seen end-on",
        "tracking/rope_match",
        " + _GRAIN[1] * (steepest - 1)",
        "",
        _SPACE,
        _CLAIMS,
    ),
    _rope(
        "the rim of an end is its tip",
        "configurations/chain_in_mask",
        "if max(head, tail) > _LEAST_RIM:",
        "if False:",
        _SPACE,
        _CLAIMS,
    ),
    _rope(
        "what looks shorter varies",
        "tracking/rope_length",
        "max(change, -_SHORTER[0] * known.spread)",
        "change",
        "tests/tracking/test_rope_length.py",
    ),
    _rope(
        "a cut that is askew turns the rope",
        "tracking/occluders",
        "_TURNS: Final = (0.0, -0.25, 0.25, -0.5, 0.5)",
        "_TURNS: Final = (0.0,)",
        _OCCLUDERS,
        _CLAIMS,
    ),
    _rope(
        "a free end is hidden as easily",
        "tracking/placement",
        "_COST: Final = (4.0, 1.0, 16.0)",
        "_COST: Final = (4.0, 1.0, 0.0)",
        _PREDICTED,
    ),
    _rope(
        "what is next to a turn is seen",
        "tracking/occlusion",
        "_TURN: Final = 0.06",
        "_TURN: Final = 0.0",
    ),
    _rope(
        "points next to what is seen end-on are valid",
        "configurations/chain_in_mask",
        "_NEAR: Final = 0.04",
        "_NEAR: Final = 0.0",
    ),
    _rope(
        "what is missing is never in doubt",
        "tracking/rope_match",
        "_LONG_AGO else placed.rival",
        "_LONG_AGO else 0.0",
        _PREDICTED,
    ),
    _rope(
        "a piece behind a gap does not slide",
        "tracking/placement",
        "(bridged if HIDDEN in ends else 0.0)",
        "0.0",
        _PREDICTED,
    ),
    _rope(
        "a rope may be too short",
        "configurations/centerline",
        "_SHORTER: Final = 1.4",
        "_SHORTER: Final = 99.0",
        _CLAIMS,
    ),
    _rope(
        "a tip may point at the camera while an end is hidden",
        "configurations/centerline",
        "_ASLANT: Final = 2.7",
        "_ASLANT: Final = 99.0",
        _CLAIMS,
    ),
    _rope(
        "a whole rope is not preferred",
        "configurations/centerline",
        "or is_whole(again.form))",
        "or False)",
        _CLAIMS,
    ),
    _rope(
        "a rope may become longer",
        "configurations/centerline",
        "_MIN_STRETCH: Final = 0.957",
        "_MIN_STRETCH: Final = 0.92",
        _OCCLUDERS,
    ),
    _rope(
        "two short pieces are enough",
        "configurations/centerline",
        "_MIN_IN_PIECES: Final = 0.45",
        "_MIN_IN_PIECES: Final = 0.3",
        _OCCLUDERS,
    ),
    _rope(
        "a rope may slide a little further",
        "configurations/centerline",
        "_ADRIFT: Final = 0.02 ",
        "_ADRIFT: Final = 0.03 ",
        _PREDICTED,
    ),
    _rope(
        "a slow shadow makes a rope shorter in metres",
        "tracking/rope_length",
        "_SHORTER: Final = (1.5, 2.0)",
        "_SHORTER: Final = (1.5, 20.0)",
        "tests/tracking/test_rope_length.py",
    ),
    _rope(
        "nodes are never out of date",
        "configurations/centerline",
        "if prediction is None or prediction.stale:",
        "if prediction is None:",
        "tests/tracking/test_occlusion.py",
    ),
    _rope(
        "a rope at rest drifts",
        "tracking/placement",
        "_AT_REST: Final = 0.35",
        "_AT_REST: Final = 0.035",
        _PREDICTED,
    ),
    _rope(
        "what is hidden keeps its relief",
        "tracking/occlusion",
        "_LEVELLING: Final = 0.1",
        "_LEVELLING: Final = 0.0",
        "tests/tracking/test_occlusion.py",
    ),
    _rope(
        "what is hidden of the middle grows",
        "tracking/occlusion",
        "    if size <= max(length, chord):\n        return piece\n",
        "    if size > 0:\n        return piece\n",
        "tests/tracking/test_occlusion.py",
    ),
    _rope(
        "a bridged gap makes a rope longer",
        "tracking/rope_length",
        "known.frames == 0 and (unbroken or known.pixels == 0):",
        "known.frames == 0:",
        "tests/tracking/test_rope_length.py",
    ),
)
