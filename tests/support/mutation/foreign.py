"""Faults in the checks of what users bring: masks, features, bundles that name code, units of depth."""

from __future__ import annotations

from .mutant import Mutant

_MASK, _FUNCTION = "tests/image/test_mask_check.py", "tests/image/test_mask_function.py"
_UNITS, _HINTS = "tests/image/test_depth_units.py", "tests/image/test_mask_hints.py"
_LIMITS, _BUNDLES = "shape_obs/deploy/policy_bundle/limits.py", "tests/deploy/policy_bundle/test_code_in_bundles.py"


def _brought(name: str, file: str, old: str, new: str, *tests: str) -> Mutant:
    return Mutant(f"brought: {name}", file, old, new, tests)


FOREIGN: tuple[Mutant, ...] = (
    _brought(
        "labels are a mask",
        "shape_obs/image/mask_check.py",
        "if low < -1 or high > 1 or low < 0 < high:",
        "if low < -1 or high > 9:",
        _MASK,
    ),
    _brought(
        "labels of long integers are a mask",
        "shape_obs/image/mask_check.py",
        "    if mask.dtype != _BYTE:\n        _check_values(mask, whose)\n",
        "    if mask.dtype != _BYTE:\n",
        _MASK,
    ),
    _brought(
        "a mask of another size is taken",
        "shape_obs/image/mask_check.py",
        "(size is not None and mask.shape != size)",
        "False",
        _MASK,
    ),
    _brought(
        "an own apply is not checked",
        "shape_obs/image/find_region.py",
        "if type(rule).apply is not Segmentation.apply:",
        "if False:",
        _MASK,
    ),
    _brought(
        "a function is called for each clean-up",
        "shape_obs/tracking/search_window.py",
        "bare = replace(rule, open=0, close=0, min_area=1, min_share=0.0)",
        "bare = rule",
        _FUNCTION,
    ),
    _brought(
        "a mask that is kept is overwritten",
        "shape_obs/image/find_region.py",
        "rule.clean(mask[window.slices].copy())",
        "rule.clean(mask[window.slices])",
        _MASK,
    ),
    _brought(
        "a lambda is saved",
        "shape_obs/image/mask_function.py",
        "        if not isinstance(self.function, str):\n            raise",
        "        if False:\n            raise",
        _FUNCTION,
    ),
    _brought(
        "a function of the script is saved",
        "shape_obs/config/config_file.py",
        "if is_of_script(path):",
        "if False:",
        _FUNCTION,
    ),
    _brought("a bundle may name code", _LIMITS, "for path in config.code_paths:", "for path in ():", _BUNDLES),
    _brought("a goal may name code", _LIMITS, "if rule is not None and rule.code_path:", "if False:", _BUNDLES),
    _brought(
        "a shape may name code",
        "shape_obs/config/detector_config.py",
        "rules = [self.segmentation, *(shape.segmentation for shape in self.shapes)]",
        "rules = [self.segmentation]",
        _BUNDLES,
    ),
    _brought(
        "a wrapper needs no segmentation",
        "shape_obs/wrappers/recorded_arguments.py",
        "if shape.segmentation is None:",
        "if False:",
        "tests/wrappers/test_own_segmentation.py",
    ),
    _brought(
        "the number of values is not checked",
        "shape_obs/features/feature.py",
        " or values.shape != (size,):",
        ":",
        "tests/features/test_own_feature.py",
    ),
    _brought(
        "a feature may be NaN",
        "shape_obs/features/feature.py",
        "(unknown[block.place] & (block.shape in sound))",
        "False",
        "tests/features/test_own_feature.py",
    ),
    _brought(
        "bounds may be NaN",
        "shape_obs/features/feature_check.py",
        "~(np.isfinite(low) & np.isfinite(high) & (low < high))",
        "low >= high",
        "tests/features/test_own_feature.py",
    ),
    _brought(
        "the unit is a warning after each reset",
        "shape_obs/image/depth_units.py",
        "self.pending, self._tries = not",
        "self.pending, self._tries = True or not",
        _UNITS,
    ),
    _brought(
        "frames without depth are looked at for ever",
        "shape_obs/image/depth_units.py",
        "self.pending = self._tries < _TRIES",
        "pass",
        _UNITS,
    ),
    _brought(
        "an empty mask is explained in every frame",
        "shape_obs/image/mask_hints.py",
        "number - last[0] >= _EVERY",
        "True",
        _HINTS,
    ),
    _brought(
        "what was found before is explained",
        "shape_obs/tracker.py",
        "return self._last is not None\n\n    def is_held",
        "return False\n\n    def is_held",
        _HINTS,
    ),
)
