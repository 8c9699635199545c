"""Set up a deployment: the controller or trained policy, the robot, and the environment around it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final

from shape_obs.cli.options import (
    RobotArguments,
    check_name,
    make_bare_env,
    make_env,
    make_robot,
    read_config,
    read_settings,
    scene_of,
)
from shape_obs.cli.parsing import Option, wrong_usage
from shape_obs.utils.documents import make_named
from shape_obs.utils.errors import UsageError

#: The value of ``--goal`` for which a simulated robot provides a new goal in each episode.
_ROBOT: Final = "robot"
_CENTIMETRE: Final = 0.01
#: Seconds from a D455's exposure to its frame, with a margin: policies are trained on images of completed motions.
_SETTLE: Final = 0.05


@dataclass(frozen=True)
class ControllerArguments(RobotArguments):
    """Options that choose the policy or controller, and its goal."""

    policy: Annotated[Path | None, Option("[POLICY]", positional=True, existing="policy")] = None
    """A trained policy, as shape_obs.save_policy writes it."""
    controller: Annotated[str | None, Option("MODULE:CLASS", "controller", check=check_name)] = None
    """A controller instead of a policy, as module:Class with act(observation); shape_obs.deploy has Still, Sway and
    Script. Default: Still."""
    controller_set: Annotated[tuple[str, ...], Option("KEY=VALUE ...", "controller", check=read_settings)] = ()
    """Arguments of the controller's class, such as share=0.2."""
    goal: Annotated[str | None, Option("FILE|robot", "controller")] = None
    """A goal file, as `shape-obs goal` writes it; the goal becomes part of the observation. With 'robot', a simulated
    robot provides a goal that it can reach, a new one for each episode."""
    episodes: Annotated[int | None, Option("N", "run", least=1)] = None
    """Run this many episodes, each from a new start, and report how often the goal was reached."""
    settle: Annotated[float | None, Option("SECONDS", "run", least=0)] = None
    """Seconds between the end of a motion and the image to act on. Default: 0.05 for a trained policy; other
    controllers take the image at the deadline of the step, even during a motion."""
    steps: Annotated[int | None, Option("N", "run", least=1)] = None
    """Largest number of steps; default for episodes with a trained policy: the length of its training episodes."""
    dry_run: Annotated[bool, Option(group="run")] = False
    """Do everything except move: the robot's state is read, but no motion is sent."""


@dataclass(frozen=True)
class Deployment:
    """A controller, the environment it reads and the robot it moves.

    Attributes:
        controller: An object with ``act(observation)``.
        env: The environment.
        robot: The robot.
        arguments: The options of the user, completed with the rate and the episode length of a trained policy.
        threshold: Mean distance in metres below which the true points count as at the goal.
    """

    controller: Any
    env: Any
    robot: Any
    arguments: Any
    threshold: float


def check_controller(args: ControllerArguments) -> None:
    """Reject options that do not go together, before anything slow is imported.

    Raises:
        UsageError: They do not; the message says which.
        FileNotFoundError: There is no such goal file.
    """
    if args.robot is None:
        raise UsageError("--robot module:Class is needed; shape_obs_envs.robots:NullRobot moves nothing.")
    if args.policy is not None and args.controller is not None:
        raise UsageError(f"expected a trained policy or --controller, got both: {args.policy} and {args.controller}.")
    if args.policy is not None and args.controller_set:
        raise UsageError("--controller-set: a trained policy takes no arguments; leave it out.")
    if args.goal not in (None, _ROBOT) and not Path(str(args.goal)).is_file():
        raise FileNotFoundError(f"{args.goal}: no such goal file")


def make_deployment(args: ControllerArguments, **options: Any) -> Deployment:
    """Make the controller, the robot and the environment; nothing is connected yet.

    Args:
        args: The options of the user.
        options: Further arguments of the environment ``ShapeObs/D455-v0``.

    Raises:
        UsageError: A value is invalid, or the policy needs a goal.
    """
    from shape_obs.cli.episodes import RobotGoals, StartFirst
    from shape_obs.deploy import DryRobot
    from shape_obs.wrappers import ShapeGoal, Target

    if args.settle is None and args.policy is not None:
        args = replace(args, settle=_SETTLE)
    options |= {"settle": args.settle}
    goal = None if args.goal in (None, _ROBOT) else Target.load(str(args.goal))
    policy = None if args.policy is None else _load(args.policy)
    if policy is None:
        settings = read_settings(args.controller_set, "--controller-set")
        with wrong_usage():
            controller = make_named(args.controller or "shape_obs.deploy:Still", "--controller", settings)
    else:
        controller = policy
        policy.same_rate = args.rate is None
        args = _with_training_defaults(args, policy)
    own = make_robot(args)
    robot: Any = DryRobot(own) if args.dry_run else own
    if args.goal == _ROBOT:
        robot = StartFirst(robot)
    if policy is None:
        env = make_env(args, robot, **options)
        if args.goal is not None:
            env = ShapeGoal(env, goal=goal)
    else:
        env = policy.wrap(make_bare_env(args, robot, **options), goal, scene_of(read_config(args, robot)))
        policy.check_env(env, same_rate=policy.same_rate)
    if args.goal == _ROBOT:
        env = RobotGoals(env, own)
    return Deployment(controller, env, robot, args, (policy and policy.spec.success_threshold) or _CENTIMETRE)


def _load(path: Path) -> Any:
    from shape_obs.policy import load_policy

    policy = load_policy(path)
    policy.check_deployable()
    return policy


def _with_training_defaults(args: ControllerArguments, policy: Any) -> ControllerArguments:
    """Fill in the policy's own rate and episode length unless the user chose others."""
    if policy.spec.needs_goal and args.goal is None and not policy.spec.has_goal:
        raise UsageError("the policy needs a goal: give --goal FILE, or --goal robot if the robot is simulated.")
    if args.rate is None:
        args = replace(args, rate=1 / policy.spec.dt)
    elif abs(args.rate * policy.spec.dt - 1) > 1e-3:
        warnings.warn(
            f"--rate {args.rate:g}: the policy was trained at {1 / policy.spec.dt:g} steps per second.",
            UserWarning,
            stacklevel=2,
        )
    steps = (
        (policy.spec.trained.get("env") or {}).get("max_episode_steps")
        if args.episodes is not None and args.steps is None
        else args.steps
    )
    return replace(args, steps=steps)
