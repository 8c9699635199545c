"""How much the configuration of a shape may ask for in a file that is not trusted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final

from shape_obs.config import DetectorConfig
from shape_obs.configurations import Configuration
from shape_obs.deploy.policy_bundle.documents import is_number
from shape_obs.deploy.policy_bundle.documents import BundleError
from shape_obs.deploy.policy_bundle.documents import needs_trust
from shape_obs.features import Feature, read_features
from shape_obs.geometry.topology import Grid
from shape_obs.spec import did_you_mean, without_plugins

#: The largest number under each name, wherever it stands; any other may be up to ``MOST_NUMBER``.
MOST: Final = {
    "n": 1000, "rows": 100, "cols": 100, "count": 100, "epochs": 100, "harmonics": 64, "degree": 32,
    "coefficients": 200, "open": 255, "close": 255, "n_init": 20, "max_iter": 1000, "steps": 1000,
    "stack_size": 8, "skip": 100, "delay": 100, "max_episode_steps": 10**9,
}  # fmt: skip
MOST_NUMBER: Final = 10**6
MOST_SHAPES, MOST_FEATURES = 8, 16
#: Points of one shape, and of all of them.
MOST_POINTS, MOST_POINTS_TOGETHER = 1024, 4096
#: Multiplications that fitting the bases of all features may take: a third of a second.
MOST_WORK: Final = 5e9


def check_numbers(value: Any, what: str, name: str = "") -> None:
    """Refuse numbers that are beyond their limits or not finite, in JSON values.

    Raises:
        BundleError: The message names the number.
    """
    if isinstance(value, Mapping):
        for key, inner in value.items():
            check_numbers(inner, what, str(key))
    elif isinstance(value, list):
        for inner in value:
            check_numbers(inner, what, name)
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        most = MOST.get(name, MOST_NUMBER)
        if not is_number(value) or abs(value) > most:
            raise needs_trust(f"{what}: {name or 'a number'} is {value!r:.40}, expected a finite number up to {most}")


def check_configuration(arguments: Mapping[str, Any], what: str) -> None:
    """Refuse arguments of a ``ShapeObservation`` that are not understood, name a plugin, or ask for too much.

    A kind of another package counts as known where that package has been imported.

    Args:
        arguments: Of a ``ShapeObservation``, or of the sections of a configuration.
        what: Where they stand, for messages.

    Raises:
        BundleError: The message says what.
        ValueError: A value is not understood.
    """
    check_numbers(arguments, what)
    workspace = arguments.get("workspace")
    if workspace is not None and not _is_box(workspace):
        raise BundleError(f"{what}: workspace: expected two corners of three numbers, got {workspace!r:.100}.")
    given = {field.name for field in fields(DetectorConfig)} & arguments.keys()
    with without_plugins():
        config = DetectorConfig.from_dict({name: arguments[name] for name in given})
        features = read_features(arguments.get("features") or ())
    shapes = config.shapes
    counts = [shape.count for shape in shapes]
    if len(shapes) > MOST_SHAPES or max(counts) > MOST_POINTS or sum(counts) > MOST_POINTS_TOGETHER:
        raise needs_trust(
            f"{what}: expected at most {MOST_SHAPES} shapes of {MOST_POINTS} points, {MOST_POINTS_TOGETHER} together, "
            f"got {len(shapes)} of up to {max(counts)}, {sum(counts)} together"
        )
    if len(features) > MOST_FEATURES:
        raise needs_trust(f"{what}: expected at most {MOST_FEATURES} features, got {len(features)}")
    if sum(_work(feature, shape) for feature in features for shape in shapes) > MOST_WORK:
        raise needs_trust(f"{what}: its features have too many coefficients for so many points")


def check_goal(arguments: Mapping[str, Any], what: str) -> None:
    """Refuse arguments of a ``ShapeGoal`` that name a plugin or ask for too much; errors as above."""
    check_numbers(arguments, what)
    goal, features = arguments.get("goal"), arguments.get("features") or ()
    with without_plugins():
        for item in [features] if isinstance(features, (str, Mapping)) else features:
            if isinstance(item, str) and item not in Feature.kinds():
                raise BundleError(f"{what}: unknown feature {item!r}{did_you_mean(item, Feature.kinds())}")
            if not isinstance(item, str):
                read_features(item)
        if isinstance(goal, Mapping) and goal.get("configuration") is not None:
            Configuration.from_dict(goal["configuration"])


def _is_box(value: Any) -> bool:
    corners = list(value) if isinstance(value, (list, tuple)) else []
    numbers = [
        number for corner in corners if isinstance(corner, (list, tuple)) and len(corner) == 3 for number in corner
    ]
    return len(corners) == 2 and len(numbers) == 6 and all(map(is_number, numbers))


def _work(feature: Feature, shape: Configuration[Any]) -> float:
    """About how many multiplications it takes to fit the basis of a feature."""
    own = (
        2 * getattr(feature, "harmonics", 0) + 1,
        getattr(feature, "degree", 0) + 1,
        getattr(feature, "coefficients", 0),
    )
    points, functions = shape.count, max(own)
    functions = min(points, functions**2 if isinstance(shape.layout, Grid) else functions)
    return 10.0 * functions**3 + 5.0 * points * functions**2
