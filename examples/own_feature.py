"""Write a feature of five values: where a rope lies, how it is turned, how much it sags.

The class statement registers the kind: mappings and config files can name it once this module
is imported.

Run: ``uv run --extra sim examples/own_feature.py``
"""

from dataclasses import dataclass

import gymnasium as gym
import numpy as np

import shape_obs_envs  # noqa: F401 - registers the environments
from shape_obs import Feature, Shape, ShapeObservation
from shape_obs.features import FeatureContext
from shape_obs.geometry.topology import Chain, Topology


@dataclass(frozen=True)
class Chord(Feature, kind="chord"):
    """Describe a rope by the line between its ends.

    The values are the middle (2), the direction (2), and the rope's largest distance from the line.
    Lengths are shares of the image's width, so that the bounds do not depend on measurements.

    Args:
        most: Largest distance from the line that is expected, image widths.
    """

    most: float = 0.5

    def bounds(self, layout: Topology, context: FeatureContext) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and highest values, of shape (5,) each."""
        if not isinstance(layout, Chain):
            raise ValueError(f"chord: expected a Chain, the points of a rope, got {layout}.")
        high = np.array([1.0, context.height / context.width, 1.0, 1.0, self.most])
        return np.array([0.0, 0.0, -1.0, -1.0, 0.0]), high

    def compute(self, shape: Shape, context: FeatureContext) -> np.ndarray:
        """Return the values, of shape (5,); NaN where the points are unknown."""
        points = shape.pixels.astype(np.float64) / context.width
        chord = points[-1] - points[0]
        length = np.hypot(*chord)
        if not length > 0:  # the ends meet, or are unknown
            return np.full(5, np.nan)
        along = chord / length
        away = np.abs((points - points[0]) @ np.array([-along[1], along[0]]))
        return np.array([*(points[0] + points[-1]) / 2, *along, away.max()])


def main() -> None:
    env = gym.make("shape_obs_envs:ShapeObs/Cable-v0", camera=[84, 84], renderer="rays")
    env = ShapeObservation(env, features=["points3d", "chord", "ok"])
    observation, info = env.reset(seed=0)
    print("observation:", observation["observation"].shape)
    for _ in range(5):
        observation, _, _, _, info = env.step(env.action_space.sample() * 0)
    blocks = env.get_wrapper_attr("blocks")
    chord = next(block for block in blocks if block.feature.kind == "chord")
    values = observation["observation"][chord.place]
    middle, direction, sag = values[:2], values[2:4], values[4]
    print(f"middle {middle.round(2)}, direction {direction.round(2)}, sag {sag:.2f}")
    inside = env.observation_space.contains(observation)
    print("ok:", info["shape/ok"], "and within the bounds:", inside)


if __name__ == "__main__":
    main()
