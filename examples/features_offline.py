"""Compute features of a recording: coefficients of curves, principal components, and the error of their points.

Without FOLDER, a simulated rope that is held at one end is recorded first. Components are fitted to four of every five
episodes, and all errors are those of the fifth ones.

Run: ``uv run --extra sim examples/features_offline.py [FOLDER]``
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from shape_obs import Shape, ShapeDetector
from shape_obs.features import Feature, FeatureContext, PointDistribution, Points3D, PrincipalComponents, read_features
from shape_obs.recording import record, replay
from shape_obs_envs.sources import open_source

EPISODES, STEPS = 6, 51
FEATURES = [
    {"kind": "fourier", "harmonics": 4, "frame": "base"},
    {"kind": "bspline", "coefficients": 8, "frame": "base"},
    {"kind": "length"},
    {"kind": "curvature"},
]


def recording() -> Path:
    """Return a folder of frames: the given one, or a new recording of the simulated rope."""
    if len(sys.argv) > 1:
        return Path(sys.argv[1])
    folder = Path("rope")
    with open_source("ShapeObs/Cable-v0", grippers=1, actions="random", seed=0, renderer="rays") as source:
        print(record(source, folder, frames=EPISODES * STEPS))
    return folder


def shapes_of(folder: Path) -> tuple[list[Shape], list[FeatureContext], np.ndarray]:
    """Return the completely measured shapes, the context of each, and their episodes."""
    detector = ShapeDetector(
        [{"kind": "centerline", "name": "rope", "n": 20, "anchor": "gripper0", "ends": "tips", "spacing": "m"}],  # type: ignore[list-item]
        {"kind": "hsv", "low": [100, 120, 40], "high": [125, 255, 255]},  # type: ignore[arg-type]
    )
    shapes, views, episodes = [], [], []
    with open_source(str(folder)) as source:
        for moment, detection in replay(source, detector):
            shape, camera = detection["rope"], moment.frame.camera
            if camera is not None and shape.ok and shape.valid.all():
                shapes.append(shape)
                views.append(FeatureContext(camera.intrinsics.width, camera.intrinsics.height, camera))
                episodes.append(moment.episode)
    return shapes, views, np.array(episodes)


def tell(name: str, feature: Feature, shapes: Sequence[Shape], views: Sequence[FeatureContext]) -> None:
    """Print the number of values of a feature, and the error of the points reconstructed from it."""
    values = [feature.compute(shape, view) for shape, view in zip(shapes, views, strict=True)]
    text = f"{name:<14} {len(values[0]):3d} values"
    if feature.invertible:
        pairs = zip(shapes, views, strict=True)
        error = [1e3 * feature.error(shape, view) for shape, view in pairs]  # type: ignore[attr-defined]
        text += f", points back within {np.mean(error):5.2f} mm, 95 % of the shapes {np.percentile(error, 95):5.2f}"
    else:
        text += f", {np.min(values):.2f} ... {np.max(values):.2f} {feature.unit}"
    print(text)


def main() -> None:
    shapes, views, episodes = shapes_of(recording())
    held = np.flatnonzero(episodes % 5 == 4)
    print(f"{len(shapes)} shapes of {episodes.max() + 1} episodes, {len(held)} held out")
    some_shapes, some_views = [shapes[i] for i in held], [views[i] for i in held]
    for feature in read_features(FEATURES):
        tell(feature.kind, feature, some_shapes, some_views)
    place = Points3D(frame="base")
    points = np.array([place.compute(*seen).reshape(-1, 3) for seen in zip(shapes, views, strict=True)])
    for aligned, name in ((False, "pca"), (True, "pca, aligned")):
        fitted = points[episodes % 5 != 4]
        model = PointDistribution.fit(fitted, 6, layout=shapes[0].layout, frame="base", aligned=aligned)
        model.save("components.npz")
        tell(name, PrincipalComponents("components.npz"), some_shapes, some_views)


if __name__ == "__main__":
    main()
