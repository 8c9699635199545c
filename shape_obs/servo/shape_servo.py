"""ShapeServo: a law at work on the observations of a ``ShapeGoal``.

Small motions at the start, by which a Jacobian is first learnt.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from shape_obs.robot import ActionSpec
from shape_obs.servo.control_law import ServoLaw, make_law
from shape_obs.servo.jacobian import check_in_range
from shape_obs.servo.weights import geometric_weights, noise_weights
from shape_obs.shape import Shape
from shape_obs.spec import Spec, SpecError

Array = npt.NDArray[np.float64]

Mask = npt.NDArray[np.bool_]


_LAW: Final = "rls"

_STILL: Final = 8  # frames over which noise is measured


class ShapeServo:
    """Brings features to those of the goal, learning on the way how they answer to the robot.

    It needs no model and no calibration. First it moves each coordinate of the robot a little, there and back; then it
    acts on the Jacobian that was learnt, and goes on learning. It is a ``Controller`` of ``shape_obs.deploy``.

    It learns from motions that are long enough to stand out from noise: from the sum of some small ones rather than
    from each. That is what keeps a law from forgetting near the goal, where all motions are small.

    Args:
        law: A ``ServoLaw``, or a name of ``LAWS``.
        actions: How many numbers an action has; ``bind`` tells it too.
        excitation: The motions at the start.
        least_motion: Length of the sum of actions that is learnt from.
        weights: What an error of features is worth: (M,F), such as ``geometric_weights``; ``"noise"``, each feature as
            a multiple of the noise that it has while nothing moves; None: all alike, which suits points.
        seen: Tells the shape in the present observation: while that is not found, held or of too few measured points,
            nothing moves and nothing is learnt. ``attach`` finds it; without it whoever calls must see to that.
        measured: Tells which of the F features were measured in the present observation: the others are neither learnt
            from nor acted on. ``attach`` finds it; None for all.
        min_valid: Share of its points that must be measured.

    Attributes:
        law: As given, or made.
        exciting: Whether the motions of the start are still going on.
        held: How many observations were not acted on.

    Example:
        >>> env = ShapeGoal(gym.make("shape_obs_envs:ShapeObs/CableShape-v0"), features=["points3d"])  # doctest: +SKIP
        >>> servo = ShapeServo("mfac")
        >>> servo.attach(env)  # doctest: +SKIP
        >>> env.step(servo.act(observation))  # doctest: +SKIP
    """

    def __init__(
        self,
        law: ServoLaw | str = _LAW,
        actions: int | None = None,
        *,
        excitation: Excitation | None = None,
        least_motion: float = 0.6,
        weights: Literal["noise"] | npt.ArrayLike | None = None,
        seen: Callable[[], Shape] | None = None,
        measured: Callable[[], Mask] | None = None,
        min_valid: float = 0.5,
    ) -> None:
        self.law = make_law(law) if isinstance(law, str) else law
        self._excitation = Excitation() if excitation is None else excitation
        self._least = check_in_range("ShapeServo: least_motion", least_motion, 100.0)
        if isinstance(weights, str) and weights != "noise":
            raise ValueError(f"ShapeServo: weights are 'noise', a matrix (M,F) or None, got {weights!r}.")
        matrix = None if weights is None or isinstance(weights, str) else np.asarray(weights, dtype=np.float64)
        self._given = (actions, seen, measured, matrix, isinstance(weights, str))
        self._size, self._seen, self._measured, self._weights, self._by_noise = self._given
        self._min_valid = check_in_range("ShapeServo: min_valid", min_valid)
        self.reset()

    def attach(self, env: Any) -> None:
        """Take from an environment with a ``ShapeGoal`` what an action is, what is seen, and what goals are worth.

        What was passed to the constructor stays. ``weights`` become ``geometric_weights`` where the goal's features
        have them, else ``"noise"``.

        Args:
            env: A Gymnasium environment.

        Raises:
            ValueError: It has no ``ShapeGoal``, or its actions are no flat ``Box`` of -1...1.
        """
        if not env.has_wrapper_attr("goal_features"):
            raise ValueError(f"ShapeServo: expected an env with a ShapeGoal, got {env}: wrap it in ShapeGoal.")
        box = env.action_space
        if len(box.shape) != 1 or not (np.all(box.low == -1) and np.all(box.high == 1)):
            raise ValueError(f"ShapeServo: expected actions in a flat Box of -1...1, got {box}.")
        # What an env that it was attached to before has told is of no use here.
        size, seen, measured, self._weights, self._by_noise = self._given
        self._size = size or int(box.shape[0])
        self._seen = seen or partial(env.get_wrapper_attr, "goal_shape")
        self._measured = measured or partial(env.get_wrapper_attr, "goal_measured")
        if self._weights is None and not self._by_noise:
            features, spec = env.get_wrapper_attr("goal_features"), env.get_wrapper_attr("goal_configuration")
            self._weights = geometric_weights(features, spec.layout, env.get_wrapper_attr("goal_context"))
            self._by_noise = self._weights is None

    def bind(self, spec: ActionSpec) -> None:
        """Take the number of coordinates of a robot."""
        self._size = len(spec)

    def reset(self) -> None:
        """Forget everything that was learnt."""
        self.held = 0
        self._marked: Array | None = None  # the features that the next change is counted from
        self._script: list[Array] = []
        self._still: list[Array] = []

    @property
    def exciting(self) -> bool:
        """Whether it has yet to move towards the goal."""
        return self._marked is None or bool(self._script)

    def act(self, observation: Mapping[str, Any]) -> npt.NDArray[np.float32]:
        """The action (A,) in -1...1 for an observation with ``achieved_goal`` and ``desired_goal``, (F,) each.

        Raises:
            ValueError: The number of actions is not known, or the goals are of another size than before, than each
                other or than the weights.
        """
        features, goal = (np.asarray(observation[key], np.float64) for key in ("achieved_goal", "desired_goal"))
        if self._size is None:
            raise ValueError("ShapeServo: how many numbers has an action? Pass actions=, or call bind.")
        size = features.shape if self._marked is None else self._marked.shape
        if features.shape != size or goal.shape != size:
            raise ValueError(
                f"ShapeServo: expected {size[0]} features, got {features.size} in achieved_goal and {goal.size} in "
                "desired_goal; after a change of features call reset."
            )
        if not self._trusted(features):
            self.held += 1
            action = np.zeros(self._size)
        else:
            known = np.ones(size, bool) if self._measured is None else self._measured()
            if self._marked is None:
                self._begin(features, known)
            self._learn(features, known)
            action = self._script.pop(0) if self._script else self.law.act(goal - features, known)
        if self._marked is not None:
            self._moved, self._last = self._moved + action, action
        return action.astype(np.float32)

    def withheld(self) -> None:
        """Take back what the last action was counted for: it was not sent."""
        if self._marked is not None:
            self._moved, self._last = self._moved - self._last, np.zeros_like(self._last)

    def _trusted(self, features: Array) -> bool:
        """Whether an observation may be learnt from and acted on."""
        shape = None if self._seen is None else self._seen()
        if shape is not None and (not shape.ok or shape.reason or shape.valid.mean() < self._min_valid):
            return False
        return bool(np.all(np.isfinite(features)))

    def _begin(self, features: Array, known: Mask) -> None:
        assert self._size is not None
        if self._weights is not None and (self._weights.ndim != 2 or self._weights.shape[1] != len(features)):
            raise ValueError(
                f"ShapeServo: weights: expected (M, {len(features)}) for {len(features)} features, got "
                f"{self._weights.shape}."
            )
        self.law.start(len(features), self._size)
        self._mark(features, known)
        still = _STILL if self._by_noise else 0
        self._script = [*np.zeros((still, self._size)), *self._excitation.actions(self._size)]
        self._still = []
        self.law.weights = self._weights

    def _mark(self, features: Array, known: Mask) -> None:
        """Count changes and motions from here."""
        assert self._size is not None
        self._marked, self._known, self._moved = features, known, np.zeros(self._size)

    def _learn(self, features: Array, known: Mask) -> None:
        """Learn from what changed since the mark, once the motion is long enough."""
        assert self._marked is not None
        if self._by_noise and len(self._still) < _STILL:
            self._still.append(features)
        if np.linalg.norm(self._moved) >= self._least:
            self.law.update(features - self._marked, self._moved, known & self._known)
            self._mark(features, known)
        if self._by_noise and self.law.weights is None and not self._script:
            assert self.law.estimator.matrix is not None
            self.law.weights = noise_weights(self._still, self.law.estimator.matrix)


@dataclass(frozen=True)
class Excitation(Spec):
    """Each coordinate by itself there and back, so that the robot ends where it began.

    Args:
        amplitude: Of the largest action, above 0, at most 1.
        hold: Steps there, and as many back: more where the object follows slowly.
    """

    amplitude: float = 0.6
    hold: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.amplitude <= 1 or self.hold < 1:
            raise SpecError(
                f"excitation: expected an amplitude above 0, at most 1, and hold of 1 step or more, got {self}."
            )

    def actions(self, size: int) -> Array:
        """(2 size hold, size) one after the other."""
        there_and_back = np.repeat([self.amplitude, -self.amplitude], self.hold)
        return np.kron(np.eye(size), there_and_back[:, None]).astype(np.float64)
