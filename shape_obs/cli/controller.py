"""What acts in a deployment, a trained policy or another controller, and the environment that it reads."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from shape_obs.cli.options import CellArguments, make_cell, make_robot, open_cell, read_config, read_settings
from shape_obs.config import SECTIONS
from shape_obs.utils.documents import make_named

#: A goal that the robot tells, in each episode another.
_ROBOT: Final = "robot"
_CENTIMETRE: Final = 0.01
#: Seconds from a D455's image to its frame, and some more: a policy was trained on images of motions that are over.
_SETTLE: Final = 0.05


@dataclass(frozen=True)
class ActingArguments(CellArguments):
    """Options that name what acts, and what for."""

    bundle: Annotated[Path | None, tyro.conf.Positional] = None
    """A trained policy, as shape_obs.save_bundle writes it."""
    trust: bool = False
    """Read a trained policy that runs code: one of an earlier version, or one with classes of its own. Only if you
    trust who made the file."""
    controller: str | None = None
    """What acts in place of a policy, as module:Class with act(observation); shape_obs.deploy has Still, Sway and
    Script. Default Still."""
    controller_set: tuple[str, ...] = ()
    """KEY=VALUE: arguments of the controller's class, such as share=0.2."""
    goal: str | None = None
    """A goal, as `shape-obs goal` writes it; the observation then tells it to the controller. 'robot' takes one that a
    simulated robot can reach from its start, another one in each episode."""
    episodes: int | None = None
    """Play so many episodes, each from a new start, and tell how often the goal was reached."""
    settle: float | None = None
    """Seconds between the end of a motion and the image that is looked at; default, of a trained policy, 0.05. Others
    look at the deadline of the step, whether the motion is over or not."""
    steps: int | None = None
    """How many steps to run at most; default, of episodes with a trained policy, as many as in its training."""
    dry_run: bool = False
    """Do everything but move: the robot is asked where it is and never sent anything."""


@dataclass(frozen=True)
class Acting:
    """What acts, and in what.

    Attributes:
        controller: With ``act``.
        env: What it reads.
        robot: What it moves.
        arguments: As asked for, with the rate and the steps of a trained policy filled in.
        threshold: Metres below which the true points are at the goal.
    """

    controller: Any
    env: Any
    robot: Any
    arguments: Any
    threshold: float


def make_acting(args: ActingArguments, **options: Any) -> Acting:
    """Make what acts, the robot, and the environment around it; nothing is connected yet.

    Args:
        args: What the user asked for.
        options: Further arguments of the environment ``ShapeObs/D455-v0``.

    Raises:
        ValueError: Something does not go together; the message says what.
    """
    from shape_obs.cli.episodes import RobotGoals, Starter
    from shape_obs.deploy import DryRobot
    from shape_obs.wrappers import ShapeGoal, Target

    _check(args)
    if args.settle is None and args.bundle is not None:
        args = replace(args, settle=_SETTLE)
    options |= {"settle": args.settle}
    goal = None if args.goal in (None, _ROBOT) else Target.load(str(args.goal))
    bundle = None if args.bundle is None else _read_bundle(args.bundle, args.trust)
    if bundle is None:
        controller = make_named(
            args.controller or "shape_obs.deploy:Still",
            "--controller",
            read_settings(args.controller_set, "--controller-set"),
        )
    else:
        controller = bundle.controller(same_rate=args.rate is None)
        args = _as_trained(args, bundle)
    own = make_robot(args)
    robot: Any = DryRobot(own) if args.dry_run else own
    if args.goal == _ROBOT:
        robot = Starter(robot)
    if bundle is None:
        env = make_cell(args, robot, **options)
        if args.goal is not None:
            env = ShapeGoal(env, goal=goal)
    else:
        config = read_config(args, robot)
        scene = {name: config[name] for name in ("shapes", *SECTIONS["scene"], *SECTIONS["runtime"]) if name in config}
        scene.pop("dt", None)  # the loop's
        env = bundle.wrap(open_cell(args, robot, **options), goal, scene)
        bundle.check_env(env, same_rate=controller.same_rate)
    if args.goal == _ROBOT:
        env = RobotGoals(env, own)
    return Acting(controller, env, robot, args, _CENTIMETRE if bundle is None else bundle.success_threshold)


def _check(args: ActingArguments) -> None:
    """Refuse options that do not go together."""
    if args.bundle is not None and args.controller is not None:
        raise ValueError(f"expected a trained policy or --controller, got both: {args.bundle} and {args.controller}.")
    if args.bundle is not None and args.controller_set:
        raise ValueError("--controller-set: a trained policy takes no arguments; leave it out.")
    if args.trust and args.bundle is None:
        raise ValueError("--trust: it is for a trained policy, and none is given; leave it out.")
    if args.episodes is not None and args.episodes < 1:
        raise ValueError(f"--episodes: expected 1 or more, got {args.episodes}.")
    if args.rate is not None and not 0 < args.rate <= 1000:
        raise ValueError(f"rate: expected hertz above 0, at most 1000, got {args.rate!r}.")


def _read_bundle(path: Path, trust: bool) -> Any:
    from shape_obs.deploy.policy_bundle import load_bundle

    bundle = load_bundle(path, trust=trust)
    bundle.check_deployable()
    return bundle


def _as_trained(args: ActingArguments, bundle: Any) -> ActingArguments:
    """With the policy's own rate and length of an episode, where nobody asks for others."""
    if bundle.needs_goal and args.goal is None and not bundle.has_goal:
        raise ValueError(
            "the policy brings the object into a goal: give --goal FILE, or --goal robot where it is simulated."
        )
    if args.rate is None:
        args = replace(args, rate=1 / bundle.dt)
    elif abs(args.rate * bundle.dt - 1) > 1e-3:
        warnings.warn(
            f"--rate {args.rate:g}: the policy was trained at {1 / bundle.dt:g} steps a second.",
            UserWarning,
            stacklevel=2,
        )
    steps = bundle.spec.max_episode_steps if args.episodes is not None and args.steps is None else args.steps
    return replace(args, steps=steps)
