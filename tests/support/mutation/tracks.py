"""Faults in tracking, in the order of points, in a rope's curve, and in the replacement of a lost shape."""

from __future__ import annotations

from .mutant import Mutant

_BELIEF = "tests/tracking/test_belief.py"
_CENTERLINE = "tests/configurations/test_centerline.py"
_DEGENERATE = "tests/test_degenerate_input.py"
_DETECTOR = "tests/test_detector.py"
_FOLDING = "tests/initialization/test_folding.py"
_MISSING = "tests/tracking/test_missing.py"
_OCCLUDERS = "tests/tracking/test_occluders.py"
_ORDER = "tests/configurations/test_order.py"
_PREDICTION = "tests/tracking/test_prediction.py"
_SEARCH = "tests/tracking/test_search_window.py"
_TIP = "tests/image/test_rope_tip.py"


def _mutant(part: str, name: str, module: str, old: str, new: str, *tests: str, equivalent: str = "") -> Mutant:
    return Mutant(f"{part}: {name}", f"shape_obs/{module}.py", old, new, tests, equivalent)


def _track(name: str, old: str, new: str, *tests: str, module: str = "prediction", equivalent: str = "") -> Mutant:
    return _mutant("tracking", name, f"tracking/{module}", old, new, *(tests or (_PREDICTION,)), equivalent=equivalent)


def _order(name: str, module: str, old: str, new: str, *tests: str, equivalent: str = "") -> Mutant:
    files = tests or (_DETECTOR, _ORDER)
    return _mutant("order", name, f"configurations/{module}", old, new, *files, equivalent=equivalent)


TRACKS: tuple[Mutant, ...] = (
    _track("prediction runs backwards", "min(max(since, 0.0), track.interval)", "min(since, track.interval)"),
    _track("prediction runs on without limit", "min(max(since, 0.0), track.interval)",
           "max(since, 0.0)"),
    _track("all of the last step", "_VELOCITY_SHARE: Final = 0.8", "_VELOCITY_SHARE: Final = 1.0"),
    _track("motion is reversed", "nodes + step", "nodes - step"),
    _track("no motion is expected", "(nodes - before) / seconds", "(nodes - nodes) / seconds"),
    _track("velocity of stamps that stand still", "interval > _LEAST_INTERVAL:", "interval > 0:"),
    _mutant("tracking", "a length may jump", "configurations/centerline",
            "if off > MAX_SIZE_CHANGE:", "if False:", _PREDICTION),
    _track("a length may change twice as much", "MAX_SIZE_CHANGE: Final = 0.06", "MAX_SIZE_CHANGE: Final = 0.12"),
    _mutant("tracking", "hidden pieces shrink the rope", "tracking/rope_length",
            "    if not whole:\n        return known\n", "", "tests/tracking/test_occlusion.py"),
    _track("a hidden piece shrinks the area", "0 if np.count_nonzero(form.interpolated) else observed.area",
           "observed.area"),
    _track("noise moves the width", "    if abs(change) <= _WIDTH_NOISE:", "    if False:"),
    _track("a width changes at once", "return max(-_MAX_WIDTH_CHANGE, min(change, _MAX_WIDTH_CHANGE))",
           "return change"),
    _track("hidden ends come back in the window",
           "if track is None or track.box is None or any(track.hints.hidden):",
           "if track is None or track.box is None:", module="search_window"),
    _track("a moving box has no more room", "spare = track.box, _SPARE + track.drift", "spare = track.box, _SPARE",
           module="search_window"),
    _track("the lower edge does not move", "abs(a + c - e - g), abs(b + d - f - h))", "abs(a + c - e - g))"),
    _track("two windows are one", "right, bottom = max(right, box.left + box.width + spare), max(bottom,",
           "right, bottom = max(0, box.left + box.width + spare), max(0,", module="search_window"),
    _mutant("tracking", "a jump is followed", "configurations/centerline",
            "off = np.inf if found.reason else", "off = 0.0 if found.reason else", _PREDICTION),
    _mutant("tracking", "the whole image is never looked at", "detector",
            "fresh = self._frames % _SEARCH_ALL == 0", "fresh = False", _SEARCH),
    _mutant("tracking", "lost shapes are not looked for elsewhere", "detector",
            "if not found.reason or found.follow or not search.widen(rule):", "if True:", _SEARCH),
    _mutant("tracking", "a track never ends", "tracker",
            "                self.track = None\n        return lost_shape(",
            "                pass\n        return lost_shape(", _MISSING, _ORDER),
    _mutant("tracking", "pixels become metres", "tracker",
            "self.track = self._last = None  # pixels cannot be compared with metres, or those of another size", "pass",
            "tests/point_cloud/test_cloud.py", "tests/point_cloud/test_cloud_lift.py"),
    _track("a clock that stands still stops the time", "            if shown >= _LEAST_STEP:",
           "            if shown > -_LEAST_STEP:", _MISSING, module="missing"),
    _track("a clock that runs back turns the time back", "            if shown >= _LEAST_STEP:",
           "            if self._started:", _MISSING, _DEGENERATE, module="missing"),
    _mutant("tracking", "a failing clock is not reported", "tracker",
            'f"{reason}; {clock.warning}" if clock.warning else reason', "reason", _MISSING),
    _mutant("tracking", "a lost track keeps its number", "tracker", "self._number + 1 if track is None",
            "1 if track is None", _PREDICTION),
    _mutant("tracking", "a new object continues the track", "tracker",
            "track = None if found.new or self._gone else self.track", "track = self.track", _PREDICTION),
    _mutant("tracking", "a track is new in every frame", "configurations/shape_points",
            "new=last is None or last.track_id != found.track_id", "new=True", _PREDICTION),
    _mutant("tracking", "reset keeps the track", "detector", "        self._followed: list[Tracker | Slots] = [",
            "        self._followed: list[Tracker | Slots] = getattr(self, '_followed', None) or [", _DETECTOR),
    _order("a centerline begins at its far end", "centerline", "return form if first <= last",
           "return form if first > last"),
    _order("an anchor is ignored", "centerline",
           "corner = np.zeros(seen.shape[1]) if target is None else target", "corner = np.zeros(seen.shape[1])"),
    _order("a contour runs either way", "contour",
           "        if not clockwise(seen):", "        if False:", _ORDER),
    _order("a contour begins anywhere", "contour", "form.starting_at(_least(far, form))",
           "form.starting_at(0.0)", "tests/configurations/test_contour.py"),
    _order("a surface begins at another corner", "surface",
           "np.argmax([level, upright, -level, -upright])", "np.argmin([level, upright, -level, -upright])",
           "tests/configurations/test_surface.py"),
    _order("a surface ignores its anchor", "surface",
           "np.argmin(np.sum((corners - target) ** 2, axis=1))", "np.argmax(np.sum((corners - target) ** 2, axis=1))",
           "tests/configurations/test_surface.py"),
    _mutant("order", "every frame is numbered again", "tracker", 'if spec.order == "image":', "if True:",
            _DETECTOR, _ORDER),
    _mutant("order", "no frame is numbered again", "tracker", 'if spec.order == "image":', "if False:",
            _DETECTOR, _ORDER),
    _order("a fitted chain is not matched to the track", "centerline",
           "            curve = match_chain(curve, prediction, tips, found)", "            pass"),
    _mutant("curve", "a long rope has too few nodes", "configurations/centerline", "_NODES: Final = (6, 128)",
            "_NODES: Final = (6, 48)", _CENTERLINE),
    _mutant("curve", "the sides of a coil are matched by their own lengths", "initialization/folding",
            "ahead = np.maximum(at[1] - width / 2 * outer, _LEAST * at[1])", "ahead = np.repeat(at[1], count)",
            _FOLDING),
    _mutant("curve", "the way to a tip turns round", "image/rope_tip", "norm / (_TIGHTEST * width)", "math.pi", _TIP),
    _mutant("missing", "held shapes are always ok", "tracking/missing", 'ok = policy == "hold" and age <= max_age',
            'ok = policy == "hold"', _MISSING),
    _mutant("missing", "truncate holds", "tracking/missing", 'ok = policy == "hold" and age <= max_age',
            "ok = age <= max_age", _MISSING),
    _mutant("missing", "held points count as seen", "tracking/missing", "no_point = np.zeros(layout.size, bool)",
            "no_point = np.ones(layout.size, bool)", _MISSING),
    _mutant("missing", "a lost shape stays as sure as it was", "tracking/missing", "sigma = aged(sigma, age,",
            "sigma = aged(sigma, 0.0,", _BELIEF),
    _mutant("missing", "pixels are taken for metres", "tracking/missing",
            "elif last.points3d is not None or not in_3d:", "else:", _BELIEF),
    _mutant("tracking", "what is hidden is as sure as what is seen", "tracking/belief",
            "hidden = _HIDDEN_SHARE * unseen[k]", "hidden = 0.0 * unseen[k]", _BELIEF),
    _mutant("tracking", "depth has no noise", "tracking/belief", "deep = noise *", "deep = 0.0 *", _BELIEF),
    _mutant("tracking", "what is seen aslant is as sure", "tracking/belief", "(1 + stretch**2)", "2",
            _BELIEF),
    _mutant("tracking", "a length that is seen end-on is as sure", "tracking/belief", "aslant * gaps.sum()",
            "0.1 * aslant * gaps.sum()", _BELIEF),
    _mutant("tracking", "a sheet's gaps say nothing", "tracking/belief", "_UNEVEN_SHARE: Final = 1.4",
            "_UNEVEN_SHARE: Final = 0.14", _BELIEF),
    _mutant("tracking", "a small image has less noise", "tracking/belief", "max(_NATIVE / columns, 1.0)", "1.0",
            _BELIEF),
    _mutant("missing", "raise holds", "tracking/missing", 'if policy == "raise":', "if False:", _MISSING),
    _mutant("missing", "nan holds", "tracking/missing", 'if last is None or policy == "nan":', "if last is None:",
            _MISSING),
    _mutant("missing", "a shape without depth is found", "configurations/shape_points",
            "if valid is None:", "if False:", "tests/point_cloud/test_lifting.py"),
    _mutant("missing", "pixels may be nan", "configurations/shape_points",
            "if points2d is not None and np.count_nonzero(np.isfinite(points2d)) < points2d.size:",
            "if False:", _DEGENERATE),
)  # fmt: skip
