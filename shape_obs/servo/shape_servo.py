"""ShapeServo: a controller that drives the features of a ``ShapeGoal`` to their goal, without a model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from shape_obs.robot import ActionSpec
from shape_obs.servo.control_law import ServoLaw, geometric_weights, make_law, noise_weights
from shape_obs.servo.jacobian import check_in_range
from shape_obs.shape import Shape
from shape_obs.spec import Spec, SpecError

Array = npt.NDArray[np.float64]

Mask = npt.NDArray[np.bool_]


_LAW: Final = "rls"

_STILL: Final = 8  # frames over which noise is measured


class ShapeServo:
    """Drive features to those of the goal, and learn the Jacobian from actions to features while moving.

    No model and no calibration are needed. At the start, each coordinate of the robot moves a little, there and back;
    after that, the controller acts on the estimated Jacobian and continues to update it. It is a ``Controller`` of
    ``shape_obs.deploy``.

    The Jacobian is updated from motions that are large compared with the noise: from the sum of several small motions
    rather than from each. Near the goal, where all motions are small, this keeps the estimate from degrading.

    Args:
        law: A ``ServoLaw``, or a name in ``LAWS``.
        actions: Number of values of an action; ``bind`` and ``attach`` set it too.
        excitation: The motions at the start.
        least_motion: Length of the summed actions after which the Jacobian is updated.
        weights: Weights of the errors of features: a matrix (M, F), such as ``geometric_weights``; ``"noise"``, which
            scales each feature by its noise while nothing moves; None for equal weights, which suits points.
        seen: Returns the shape in the current observation, or several. While one is lost, held, or has too few measured
            points, nothing moves and nothing is learnt. ``attach`` provides it; otherwise this is up to the caller.
        measured: Returns which of the F features were measured in the current observation; the others are ignored.
            ``attach`` provides it; None for all.
        min_valid: Share of the points that must be measured.
        coordinates: The indices of the values of an action that may move the shape, such as those of the gripper that
            holds it; the others stay zero. None for all. Without them, a robot that also has other grippers would move
            these at random by the noise of the features.

    Attributes:
        law: The law.
        exciting: Whether the motions at the start are still in progress.
        held: Number of observations without an action.

    Example:
        >>> env = ShapeGoal(gym.make("shape_obs_envs:ShapeObs/CableShape-v0"), features=["points3d"])  # doctest: +SKIP
        >>> servo = ShapeServo("mfac")
        >>> servo.attach(env)  # doctest: +SKIP
        >>> env.step(servo.act(observation))  # doctest: +SKIP
    """

    law: ServoLaw
    held: int

    def __init__(
        self,
        law: ServoLaw | str = _LAW,
        actions: int | None = None,
        *,
        excitation: Excitation | None = None,
        least_motion: float = 0.6,
        weights: Literal["noise"] | npt.ArrayLike | None = None,
        seen: Callable[[], Shape | Sequence[Shape]] | None = None,
        measured: Callable[[], Mask] | None = None,
        min_valid: float = 0.5,
        coordinates: Sequence[int] | None = None,
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
        self._coordinates = None if coordinates is None else _checked(coordinates)
        self.reset()

    def attach(self, env: Any) -> None:
        """Take the size of actions, the detected shapes and the weights from an environment with a ``ShapeGoal``.

        Arguments of the constructor take precedence. ``weights`` become ``geometric_weights`` if the goal's features
        have them, else ``"noise"``.

        Args:
            env: A Gymnasium environment.

        Raises:
            ValueError: The environment has no ``ShapeGoal``, or its actions are not a flat ``Box`` of -1...1.
        """
        if not env.has_wrapper_attr("goal_features"):
            raise ValueError(f"ShapeServo: expected an env with a ShapeGoal, got {env}: wrap it in ShapeGoal.")
        box = env.action_space
        if len(box.shape) != 1 or not (np.all(box.low == -1) and np.all(box.high == 1)):
            raise ValueError(f"ShapeServo: expected actions in a flat Box of -1...1, got {box}.")
        # Discard everything from an environment that it was attached to before.
        size, seen, measured, self._weights, self._by_noise = self._given
        self._size = size or int(box.shape[0])
        self._seen = seen or partial(env.get_wrapper_attr, "goal_shapes")
        self._measured = measured or partial(env.get_wrapper_attr, "goal_measured")
        if self._weights is None and not self._by_noise:
            features, specs = env.get_wrapper_attr("goal_features"), env.get_wrapper_attr("goal_configurations")
            pairs = zip(specs, env.get_wrapper_attr("goal_contexts"), strict=True)
            blocks = [geometric_weights(features, spec.layout, context) for spec, context in pairs]
            known = [block for block in blocks if block is not None]
            self._by_noise = len(known) < len(blocks)
            self._weights = None if self._by_noise else np.asarray(block_diag(*known), np.float64)

    def bind(self, spec: ActionSpec) -> None:
        """Set the size of actions to the number of coordinates of a robot."""
        self._size = len(spec)

    def reset(self) -> None:
        """Reset the controller; it starts again with the excitation."""
        self.held = 0
        self._marked: Array | None = None  # the features at the start of the summed motion
        self._script: list[Array] = []
        self._still: list[Array] = []

    @property
    def exciting(self) -> bool:
        """Whether the motions at the start are still in progress."""
        return self._marked is None or bool(self._script)

    def act(self, observation: Mapping[str, Any]) -> npt.NDArray[np.float32]:
        """Return the action (A,), -1...1, for an observation with ``achieved_goal`` and ``desired_goal``, (F,) each.

        Raises:
            ValueError: The size of actions is unknown, or the size of a goal has changed or does not fit the weights.
        """
        features, goal = (np.asarray(observation[key], np.float64) for key in ("achieved_goal", "desired_goal"))
        if self._size is None:
            raise ValueError("ShapeServo: the size of actions is unknown. Pass actions=, or call bind.")
        used = list(range(self._size)) if self._coordinates is None else self._coordinates
        if max(used) >= self._size:
            raise ValueError(
                f"ShapeServo: coordinates: expected indices below {self._size}, the size of actions, got {used}."
            )
        size = features.shape if self._marked is None else self._marked.shape
        if features.shape != size or goal.shape != size:
            raise ValueError(
                f"ShapeServo: expected {size[0]} features, got {features.size} in achieved_goal and {goal.size} in "
                "desired_goal; after a change of features call reset."
            )
        if not self._trusted(features):
            self.held += 1
            moves = np.zeros(len(used))
        else:
            known = np.ones(size, bool) if self._measured is None else self._measured()
            if self._marked is None:
                self._begin(features, known, len(used))
            self._learn(features, known)
            moves = self._script.pop(0) if self._script else self.law.act(goal - features, known)
        if self._marked is not None:
            self._moved, self._last = self._moved + moves, moves
        action = np.zeros(self._size, np.float32)
        action[used] = moves
        return action

    def withheld(self) -> None:
        """Remove the last action from the summed motion, because it was not sent."""
        if self._marked is not None:
            self._moved, self._last = self._moved - self._last, np.zeros_like(self._last)

    def _trusted(self, features: Array) -> bool:
        """Return whether an observation may be used."""
        seen = () if self._seen is None else self._seen()
        for shape in seen if isinstance(seen, Sequence) else (seen,):
            if not shape.ok or shape.reason or shape.valid.mean() < self._min_valid:
                return False
        return bool(np.all(np.isfinite(features)))

    def _begin(self, features: Array, known: Mask, actions: int) -> None:
        if self._weights is not None and (self._weights.ndim != 2 or self._weights.shape[1] != len(features)):
            raise ValueError(
                f"ShapeServo: weights: expected (M, {len(features)}) for {len(features)} features, got "
                f"{self._weights.shape}."
            )
        self.law.start(len(features), actions)
        self._mark(features, known)
        still = _STILL if self._by_noise else 0
        self._script = [*np.zeros((still, actions)), *self._excitation.actions(actions)]
        self._still = []
        self.law.weights = self._weights

    def _mark(self, features: Array, known: Mask) -> None:
        """Start summing changes and motions."""
        assert self.law.estimator.matrix is not None
        self._marked, self._known = features, known
        self._moved = np.zeros(self.law.estimator.matrix.shape[1])

    def _learn(self, features: Array, known: Mask) -> None:
        """Update the Jacobian from the changes since the mark, once the motion is long enough."""
        assert self._marked is not None
        if self._by_noise and len(self._still) < _STILL:
            self._still.append(features)
        if np.linalg.norm(self._moved) >= self._least:
            self.law.update(features - self._marked, self._moved, known & self._known)
            self._mark(features, known)
        if self._by_noise and self.law.weights is None and not self._script:
            assert self.law.estimator.matrix is not None
            self.law.weights = noise_weights(self._still, self.law.estimator.matrix)


def _checked(coordinates: Sequence[int]) -> list[int]:
    """Return the indices of values of an action, after checking them."""
    used = list(coordinates)
    if not used or len(set(used)) < len(used) or not all(type(at) is int and at >= 0 for at in used):
        raise ValueError(f"ShapeServo: coordinates: expected different indices of values of an action, got {used}.")
    return used


@dataclass(frozen=True)
class Excitation(Spec):
    """The motions at the start: each coordinate in turn, there and back.

    Args:
        amplitude: Share of the largest action, above 0 and at most 1.
        hold: Number of steps in each direction; use more if the object follows slowly.
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
        """Return the actions in order, of shape (2 * size * hold, size)."""
        there_and_back = np.repeat([self.amplitude, -self.amplitude], self.hold)
        return np.kron(np.eye(size), there_and_back[:, None]).astype(np.float64)
