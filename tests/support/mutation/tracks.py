"""Faults in tracking, in the order of points, and in what stands in for a lost shape."""

from __future__ import annotations

from .mutant import Mutant


def _mutant(part: str, name: str, module: str, old: str, new: str, *tests: str, equivalent: str = "") -> Mutant:
    files = tuple(f"tests/test_{test}.py" for test in tests)
    return Mutant(f"{part}: {name}", f"shape_obs/{module}.py", old, new, files, equivalent)


def _track(name: str, old: str, new: str, *tests: str, equivalent: str = "") -> Mutant:
    return _mutant("tracking", name, "tracking", old, new, *(tests or ("tracking",)), equivalent=equivalent)


def _order(name: str, module: str, old: str, new: str, *tests: str, equivalent: str = "") -> Mutant:
    return _mutant("order", name, module, old, new, *(tests or ("detector", "order")), equivalent=equivalent)


TRACKS: tuple[Mutant, ...] = (
    _track("prediction runs backwards", "max(stamp - track.stamp, 0.0)", "(stamp - track.stamp)"),
    _track("prediction runs on for ever", "min(max(stamp - track.stamp, 0.0), track.interval)",
           "max(stamp - track.stamp, 0.0)"),
    _track("all of the last step", "_VELOCITY_SHARE: Final = 0.8", "_VELOCITY_SHARE: Final = 1.0"),
    _track("motion is reversed", "track.nodes + _VELOCITY_SHARE", "track.nodes - _VELOCITY_SHARE"),
    _track("no motion is expected", "velocity = (nodes - track.nodes) / interval", "pass"),
    _track("velocity of stamps that stand still", "interval > _LEAST_INTERVAL:", "interval > 0:", "degenerate_input"),
    _track("a length may jump", "if abs(after / before - 1) <= _MAX_SIZE_CHANGE:", "if True:"),
    _track("a length may change twice as much", "_MAX_SIZE_CHANGE: Final = 0.06", "_MAX_SIZE_CHANGE: Final = 0.12"),
    _track("hidden pieces shrink the rope", "form.memory.size or form.size", "form.size"),
    _track("a hidden piece shrinks the area", "amount if form.whole else 0", "amount"),
    _track("noise moves the width", "    if abs(change) <= _WIDTH_NOISE:", "    if False:"),
    _track("a width changes at once", "return max(-_MAX_WIDTH_CHANGE, min(change, _MAX_WIDTH_CHANGE))",
           "return change"),
    _track("hidden ends come back in the window", "if track.box is None or any(track.memory.hidden):",
           "if track.box is None:"),
    _track("a moving box has no more room", "spare = _SPARE + track.drift", "spare = _SPARE"),
    _track("the lower edge does not move", "abs(a + c - e - g), abs(b + d - f - h))", "abs(a + c - e - g))"),
    _track("two windows are one", "Expected(self.window.united(other.window), ", "Expected(self.window, "),
    _mutant("tracking", "a jump is followed", "fitting", "reason=jump) if jump else found",
            'reason="") if jump else found',
            "tracking"),
    _mutant("tracking", "the whole image is never looked at", "detector", "self._looked % _LOOK_AROUND == 0", "False",
            "tracked_window"),
    _mutant("tracking", "lost shapes are not looked for elsewhere", "detector",
            "if not found.ok and view.look_everywhere",
            "if False and view.look_everywhere", "tracked_window"),
    _mutant("tracking", "a track never ends", "detector",
            "            self._tracks.pop(spec.name, None)\n        return",
            "            pass\n        return", "missing", "order"),
    _mutant("tracking", "pixels become metres", "detector",
            "self._tracks.pop(spec.name, None)  # pixels say nothing about metres\n"
            "            self._last.pop(spec.name, None)", "pass", "cloud", "cloud_lift"),
    _mutant("tracking", "an older clock makes ages negative", "detector", "elif stamp < self._stamp:", "elif False:",
            "degenerate_input"),
    _mutant("tracking", "reset keeps the track", "detector", "self._tracks: dict[str, Track] = {}",
            "self._tracks: dict[str, Track] = getattr(self, '_tracks', {})", "detector"),
    _order("a centerline begins at its far end", "configurations/centerline", "return form if first <= last",
           "return form if first > last"),
    _order("an anchor is ignored", "configurations/centerline",
           "corner = np.zeros(seen.shape[1]) if target is None else target", "corner = np.zeros(seen.shape[1])"),
    _order("a contour runs either way", "configurations/contour",
           "        if not clockwise(seen):", "        if False:", "order"),
    _order("a contour begins anywhere", "configurations/contour", "form.begun_at(_least(far, form))",
           "form.begun_at(0.0)", "contour"),
    _order("a surface begins at another corner", "configurations/surface",
           "np.argmax([level, upright, -level, -upright])", "np.argmin([level, upright, -level, -upright])", "surface"),
    _order("a surface ignores its anchor", "configurations/surface",
           "np.argmin(np.sum((corners - target) ** 2, axis=1))", "np.argmax(np.sum((corners - target) ** 2, axis=1))",
           "surface"),
    _order("every frame is numbered afresh", "fitting", 'if spec.order == "image" else found', "if True else found"),
    _order("no frame is numbered afresh", "fitting", 'if spec.order == "image" else found', "if False else found"),
    _order("a fresh start forgets the direction", "fitting",
           "    start = spec.nodes(form, topology)\n    return _settle(",
           "    start = spec.nodes(form, topology)\n    prediction = None\n    return _settle(", "covered"),
    _order("what is settled follows nothing", "fitting",
           "        form = spec.follow(form, prediction)\n    verdict", "        pass\n    verdict"),
    _mutant("missing", "held shapes are ok for ever", "missing", 'ok=policy == "hold" and age <= max_age',
            'ok=policy == "hold"', "missing"),
    _mutant("missing", "truncate holds", "missing", 'ok=policy == "hold" and age <= max_age', "ok=age <= max_age",
            "missing"),
    _mutant("missing", "held points count as seen", "missing", "nobody = np.zeros(layout.size, bool)",
            "nobody = np.ones(layout.size, bool)", "missing"),
    _mutant("missing", "raise holds", "missing", 'if policy == "raise":', "if False:", "missing"),
    _mutant("missing", "nan holds", "missing", 'if last is None or policy == "nan":', "if last is None:", "missing"),
    _mutant("missing", "a shape without depth is found", "detector", "(not in_3d or np.count_nonzero(shape.valid))",
            "True", "lift"),
    _mutant("missing", "pixels may be nan", "detector",
            "shape.points2d is None or np.isfinite(shape.points2d).all()", "True",
            "degenerate_input"),
)  # fmt: skip
