"""The settings of an episode of shape servoing: environment, features, law, and the source of the points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final, NamedTuple, get_args

from shape_obs.geometry.topology import Chain, Grid, Ring, Topology
from tests.benchmarks import Difficulty, FeatureSet, ServoEnv, Source

#: The topology of each environment's points, as it publishes it.
LAYOUTS: Final[Mapping[ServoEnv, Topology]] = {
    "Cable": Chain(20),
    "Ring": Ring(32),
    "Cloth": Grid(4, 8),
    "Hanging": Chain(20),
    "Cables": Chain(20),
}


def _base(kind: str, **more: Any) -> dict[str, Any]:
    return {"kind": kind, "frame": "base", **more}


# Features without position are joined by the centroid, those without rotation by the orientation.
_PLACE: Final = (_base("orientation"), _base("centroid"))
_EVERYWHERE: Final[Mapping[FeatureSet, tuple[dict[str, Any], ...]]] = {
    "points3d": (_base("points3d"),),
    "points2d": ({"kind": "points2d"},),
    "tangents": (_base("tangents"), _base("centroid")),
}
_LINES: Final[Mapping[FeatureSet, tuple[dict[str, Any], ...]]] = {
    "curvature": (_base("curvature"), *_PLACE),
    "turning_angles": (_base("turning_angles"), *_PLACE),
}
_ROPE: Final[Mapping[FeatureSet, tuple[dict[str, Any], ...]]] = {
    "fourier": (_base("fourier", harmonics=4),),
    "bezier": (_base("bezier", degree=6),),
    "bspline": (_base("bspline", coefficients=8),),
}
#: The sets of features of each environment, except ``"pca"``, which needs a file.
FEATURES: Final[Mapping[ServoEnv, Mapping[FeatureSet, tuple[dict[str, Any], ...]]]] = {
    "Cable": {
        **_EVERYWHERE,
        **_LINES,
        **_ROPE,
        "moments": (_base("contour_moments", order=3),),
    },
    "Ring": {
        **_EVERYWHERE,
        **_LINES,
        "fourier": (_base("elliptic_fourier", harmonics=6),),
        "bspline": (_base("bspline", coefficients=8),),
        "moments": (_base("contour_moments", order=3), _base("region_moments", order=3)),
    },
    "Cloth": {
        **_EVERYWHERE,
        "fourier": (_base("fourier", harmonics=4),),
        "bezier": (_base("bezier", degree=6),),
        "bspline": (_base("bspline", coefficients=5),),
        "moments": (_base("region_moments", order=3),),
    },
    "Cables": {**_EVERYWHERE, **_LINES, **_ROPE},
    # Moments, angles and curvatures are those of a plane.
    "Hanging": {**_EVERYWHERE, **_ROPE},
}


class Disturbance(NamedTuple):
    """Disturbances of the images of an episode.

    Args:
        invalid: Share of the points that are lost, drawn again in every frame, and interpolated from the others.
        blackout: The step after which black frames begin, and their number; None for none.
    """

    invalid: float = 0.0
    blackout: tuple[int, int] | None = None

    def check(self) -> None:
        """Raise ValueError if the share or the blackout is out of range."""
        if not 0 <= self.invalid < 1:
            raise ValueError(f"invalid: expected a share of the points from 0, below 1, got {self.invalid}.")
        if self.blackout is not None and (self.blackout[0] < 1 or self.blackout[1] < 1):
            raise ValueError(f"blackout: expected the first step and how many, at least 1 each, got {self.blackout}.")


class Setting(NamedTuple):
    """One combination of an environment, features, a law and a source of points.

    Args:
        env: The environment.
        difficulty: Distance of the goals from the start.
        source: ``"camera"``: points detected in the images of a D455; ``"truth"``: the points of the simulator;
            ``"taught"``: the camera for the points and also for the goal, as a goal is recorded on a real table.
        size: Image size such as ``"160x120"``; features in pixels need it for the truth as well.
        features: A name of ``FEATURES``, or ``"pca"``.
        law: A name of ``shape_obs.servo.LAWS``.
        disturbance: The disturbance of the images.
        renderer: The simulator's renderer.
        pca: The file for ``"pca"``.
        view: Where the camera of the hanging rope stands; None for the environment's default.
        rope: Which of several ropes is brought to its goal; None for the environment's default.
    """

    env: ServoEnv
    difficulty: Difficulty
    source: Source
    size: str
    features: FeatureSet
    law: str
    disturbance: Disturbance = Disturbance()
    renderer: str = "auto"
    pca: str | None = None
    view: str | None = None
    rope: int | None = None

    @property
    def pixels(self) -> tuple[int, int]:
        """(width, height) of the images."""
        width, _, height = self.size.partition("x")
        return int(width), int(height)

    @property
    def name(self) -> str:
        """A unique name for files and messages."""
        parts = [self.env, self.difficulty, self.source, self.size, self.features, self.law]
        if self.disturbance.invalid:
            parts.append(f"invalid{self.disturbance.invalid:g}")
        if self.disturbance.blackout is not None:
            parts.append("blackout{}x{}".format(*self.disturbance.blackout))
        if self.view is not None:
            parts.append(self.view)
        if self.rope is not None:
            parts.append(f"rope{self.rope}")
        return "-".join(parts)


def feature_set(env: ServoEnv, name: FeatureSet, pca: str | None = None) -> tuple[dict[str, Any], ...] | None:
    """Return the specs of a set of features, or None if the environment has no such set.

    Raises:
        ValueError: ``"pca"`` without a file.
    """
    if name != "pca":
        return FEATURES[env].get(name)
    if pca is None:
        raise ValueError("features 'pca' need the file that `shape-obs fit-features` wrote: give --pca FILE.")
    return ({"kind": "pca", "file": pca},)


def combinations(
    envs: Sequence[ServoEnv],
    features: Sequence[FeatureSet],
    laws: Sequence[str],
    difficulties: Sequence[Difficulty] = get_args(Difficulty),
    sources: Sequence[Source] = ("camera", "truth"),
    sizes: Sequence[str] = ("160x120",),
    disturbance: Disturbance = Disturbance(),  # noqa: B008  a tuple of constants
    renderer: str = "auto",
    pca: str | None = None,
) -> Iterator[Setting]:
    """Generate every existing combination; disturbances apply only to the camera's images.

    Raises:
        ValueError: ``"pca"`` without a file.
    """
    for env, size, name, law, difficulty, source in product(envs, sizes, features, laws, difficulties, sources):
        if feature_set(env, name, pca) is None:
            continue
        wrong = Disturbance() if source == "truth" else disturbance
        yield Setting(env, difficulty, source, size, name, law, wrong, renderer, pca if name == "pca" else None)


def missing(envs: Sequence[ServoEnv], features: Sequence[FeatureSet]) -> list[str]:
    """Return the requested feature sets that do not exist, such as ``"bezier of Ring"``."""
    return [f"{name} of {env}" for env in envs for name in features if name != "pca" and name not in FEATURES[env]]
