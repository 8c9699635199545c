"""What an episode of shape servoing is made of: an environment, features, a law, and where the points come from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final, Literal, NamedTuple, get_args

from shape_obs.bench.env_speed import Env
from shape_obs.geometry.topology import Chain, Grid, Ring, Topology

Difficulty = Literal["near", "middle", "far"]
Source = Literal["camera", "truth", "taught"]
FeatureSet = Literal[
    "points3d", "points2d", "fourier", "bezier", "bspline", "tangents", "curvature", "turning_angles", "moments", "pca"
]

DIFFICULTIES: Final[tuple[Difficulty, ...]] = get_args(Difficulty)
SOURCES: Final[tuple[Source, ...]] = ("camera", "truth")
SETS: Final[tuple[FeatureSet, ...]] = get_args(FeatureSet)
#: How the points of each environment hang together, as it publishes it.
LAYOUTS: Final[Mapping[Env, Topology]] = {"Cable": Chain(20), "Ring": Ring(32), "Cloth": Grid(4, 8)}


def _base(kind: str, **more: Any) -> dict[str, Any]:
    return {"kind": kind, "frame": "base", **more}


# What does not tell where the shape is, gets the centroid; what does not tell how it is turned, the orientation.
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
#: The sets of features that there are for each environment, but ``"pca"``, which needs a file.
FEATURES: Final[Mapping[Env, Mapping[FeatureSet, tuple[dict[str, Any], ...]]]] = {
    "Cable": {
        **_EVERYWHERE,
        **_LINES,
        "fourier": (_base("fourier", harmonics=4),),
        "bezier": (_base("bezier", degree=6),),
        "bspline": (_base("bspline", coefficients=8),),
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
}


class Disturbance(NamedTuple):
    """What goes wrong in the images of an episode.

    Args:
        invalid: Share of the points that are lost, drawn anew in every frame, and filled in from the others.
        blackout: The first black frame, the one after so many steps, and how many there are; None for none.
    """

    invalid: float = 0.0
    blackout: tuple[int, int] | None = None

    def check(self) -> None:
        """Raises ValueError: a share outside of 0...1, or a blackout that is none."""
        if not 0 <= self.invalid < 1:
            raise ValueError(f"invalid: expected a share of the points from 0, below 1, got {self.invalid}.")
        if self.blackout is not None and (self.blackout[0] < 1 or self.blackout[1] < 1):
            raise ValueError(f"blackout: expected the first step and how many, at least 1 each, got {self.blackout}.")


class Setting(NamedTuple):
    """One combination of what is compared.

    Args:
        env: The environment.
        difficulty: How far goals are from the start.
        source: ``"camera"``: points found in the images of a D455; ``"truth"``: those of the simulator; ``"taught"``:
            the camera's, and the goal too is what the camera saw of it, as one records a goal on a real table.
        size: Of the images, ``"160x120"``; the truth has none, but features in pixels need it.
        features: A name of ``FEATURES``, or ``"pca"``.
        law: A name of ``shape_obs.servo.LAWS``.
        disturbance: Of the images.
        renderer: The simulator's camera.
        pca: The file for ``"pca"``.
    """

    env: Env
    difficulty: Difficulty
    source: Source
    size: str
    features: FeatureSet
    law: str
    disturbance: Disturbance = Disturbance()
    renderer: str = "auto"
    pca: str | None = None

    @property
    def pixels(self) -> tuple[int, int]:
        """(width, height) of the images."""
        return image_size(self.size)

    @property
    def name(self) -> str:
        """What tells it from all others, for files and messages."""
        parts = [self.env, self.difficulty, self.source, self.size, self.features, self.law]
        if self.disturbance.invalid:
            parts.append(f"invalid{self.disturbance.invalid:g}")
        if self.disturbance.blackout is not None:
            parts.append("blackout{}x{}".format(*self.disturbance.blackout))
        return "-".join(parts)


def image_size(text: str) -> tuple[int, int]:
    """(width, height) from ``"160x120"``.

    Raises:
        ValueError: It is no size.
    """
    width, x, height = text.partition("x")
    if not (x and width.isdigit() and height.isdigit()):
        raise ValueError(f"size: expected WIDTHxHEIGHT in pixels, such as 160x120, got {text!r}.")
    return int(width), int(height)


def feature_set(env: Env, name: FeatureSet, pca: str | None = None) -> tuple[dict[str, Any], ...] | None:
    """The specs of a set of features; None where there is no such set for an environment.

    Raises:
        ValueError: ``"pca"`` without a file.
    """
    if name != "pca":
        return FEATURES[env].get(name)
    if pca is None:
        raise ValueError("features 'pca' need the file that `shape-obs fit-features` wrote: give --pca FILE.")
    return ({"kind": "pca", "file": pca},)


def combinations(
    envs: Sequence[Env],
    features: Sequence[FeatureSet],
    laws: Sequence[str],
    difficulties: Sequence[Difficulty] = DIFFICULTIES,
    sources: Sequence[Source] = SOURCES,
    sizes: Sequence[str] = ("160x120",),
    disturbance: Disturbance = Disturbance(),  # noqa: B008  a tuple of constants
    renderer: str = "auto",
    pca: str | None = None,
) -> Iterator[Setting]:
    """Every combination that there is; the camera's images alone are disturbed.

    Raises:
        ValueError: ``"pca"`` without a file.
    """
    for env, size, name, law, difficulty, source in product(envs, sizes, features, laws, difficulties, sources):
        if feature_set(env, name, pca) is None:
            continue
        wrong = Disturbance() if source == "truth" else disturbance
        yield Setting(env, difficulty, source, size, name, law, wrong, renderer, pca if name == "pca" else None)


def missing(envs: Sequence[Env], features: Sequence[FeatureSet]) -> list[str]:
    """What was asked for and cannot be had: ``"bezier of Ring"``."""
    return [f"{name} of {env}" for env in envs for name in features if name != "pca" and name not in FEATURES[env]]
