"""Saved policies: time of an action and of loading, what a robot has to install, and success as by the learner."""

from __future__ import annotations

import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.benchmarks.claim import Claim, Limit
from tests.benchmarks.tables import Row

#: Algorithm, policy class and observation of small untrained policies; those with goals are normalised.
_POLICIES: Final = {
    "SAC, goals": ("SAC", "MultiInput", "GOALS"),
    "PPO": ("PPO", "Mlp", "VECTOR"),
    "PPO, image": ("PPO", "Cnn", "IMAGE"),
    "RecurrentPPO": ("RecurrentPPO", "MlpLstm", "VECTOR"),
}
_LAYERS: Final = {"net_arch": [256, 256]}
_REPLAYS: Final = (32, 1024)  # the shortest and the longest, in steps
_STUDY: Final = Path(__file__).parents[2] / "examples" / "ablations" / "curves.yaml"
_TRAINING: Final = 15_000  # steps, some five minutes on one core
_DEPLOY: Final = (
    "import sys, shape_obs.cli.deploy, shape_obs.deploy, shape_obs.policy; assert 'torch' not in sys.modules"
)
_STARTS: Final = 5  # fresh processes, of which the fastest counts


def actions(scene: tuple[str, int]) -> Row:
    """Time the actions of a policy in turns with those of its learner, and how long it takes to load it."""
    sys.path.append(str(Path(__file__).parents[1] / "support"))
    import policies
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    from shape_obs.policy import load_policy, save_policy, save_policy_onnx

    name, count = scene
    algorithm, network, observed = _POLICIES[name]
    space: Any = getattr(policies, observed)
    env: Any = policies.Sampled(space)
    training: Any = VecNormalize(DummyVecEnv([lambda: env])) if observed == "GOALS" else env
    model = policies.learner(training, algorithm, network, policy_kwargs=_LAYERS)
    took: dict[str, list[float]] = {"file": [], "learner": []}
    with TemporaryDirectory() as folder:
        path = Path(folder, "a.policy")
        save_policy(model, training, path)
        policy, state = load_policy(path), None
        seen = [space.sample() for _ in range(max(count, *_REPLAYS))]
        for observation in seen[:count]:
            begin = time.perf_counter()
            policy.act(observation)
            between = time.perf_counter()
            batch = training.normalize_obs(observation) if observed == "GOALS" else observation
            _, state = model.predict(batch, state, deterministic=True)
            took["learner"].append(time.perf_counter() - between)
            took["file"].append(between - begin)
        policy.reset()
        found = [policy.act(each) for each in seen]
        with zipfile.ZipFile(path) as archive:
            content = archive.read("policy.onnx")
        loads = {}
        for steps in _REPLAYS:
            save_policy_onnx(path, content, env, seen[:steps], found[:steps], states=policy.spec.states)
            begin = time.perf_counter()
            load_policy(path)
            loads[f"load, {steps} steps [ms]"] = 1e3 * (time.perf_counter() - begin)
    file, learner = (1e3 * float(np.median(took[who])) for who in ("file", "learner"))
    return Row({"policy": name, "file [ms]": file, "learner [ms]": learner, "file / learner": file / learner, **loads})


def environment(extra: str) -> Row:
    """Return the size of what this package needs with an extra, and for ``deploy`` the time of a start.

    The size is that of the files that the distributions list: without Python, byte code and the code that Numba
    compiles, and without drivers of a camera and a robot.
    """
    import shape_obs

    names = {"shape-obs"} | set(_needed("shape-obs", frozenset({extra})))
    files = [metadata.distribution(name).locate_file(file) for name in names for file in metadata.files(name) or ()]
    own = Path(shape_obs.__file__).parent  # an editable installation lists no files
    files += [file for file in own.rglob("*") if "__pycache__" not in file.parts]
    size = sum(Path(str(file)).stat().st_size for file in set(map(str, files)) if Path(file).is_file())
    fastest = min(_start() for _ in range(_STARTS)) if extra == "deploy" else None
    return Row({"extra": extra, "packages": len(names), "size [MB]": size / 1e6, "import [s]": fastest})


def _start() -> float:
    """Return the seconds in which a new process imports what a deployment needs."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", _DEPLOY], check=True)
    return time.perf_counter() - begin


def _needed(name: str, extras: frozenset[str]) -> Iterator[str]:
    """Yield the distributions that one needs with some extras, some of them more than once."""
    for text in metadata.requires(name) or ():
        found = Requirement(text)
        if found.marker is None or any(found.marker.evaluate({"extra": extra}) for extra in extras | {""}):
            if found.name != name:
                yield canonicalize_name(found.name)
            yield from _needed(found.name, frozenset(found.extras))


def success(scene: tuple[int, int]) -> Row:
    """Train SAC with hindsight replay on the cable, and count the goals that the model and the file reach."""
    from shape_obs.ablation.scores import play
    from shape_obs.ablation.study import Evaluation, load_study
    from shape_obs.ablation.training_run import act_of, make_env, run
    from shape_obs.policy import load_policy, save_policy

    steps, goals = scene
    plan = Evaluation(every=steps, final_goals=1, difficulties=("middle",))
    study = replace(load_study(_STUDY), steps=steps, evaluation=plan)
    begin = time.perf_counter()
    trained = run(study, "points3d", 0)
    seconds = time.perf_counter() - begin
    with TemporaryDirectory() as folder:
        save_policy(trained.model, trained.env, path := Path(folder, "a.policy"))
        policy = load_policy(path)
    trained.env.close()
    trial = make_env(study.arms["points3d"], study.env, {"reward_type": "sparse"}, study.episode)
    seeds = range(plan.seed, plan.seed + goals)
    reached = {
        who: [score.success for score in play(trial, act, plan.difficulties, seeds, study.episode)]
        for who, act in (("model", act_of(trained.model)), ("file", policy.act))
    }
    trial.close()
    shares = {f"{who} [%]": 100 * float(np.mean(found)) for who, found in reached.items()}
    other = sum(one != two for one, two in zip(*reached.values(), strict=True))
    return Row({"training [steps]": steps, "training [s]": seconds, "goals": goals, **shares, "other outcome": other})


CLAIMS: Final = (
    Claim(
        "policies.actions", "Time of an action of a saved policy and of its learner, and of loading it.",
        lambda effort: ((name, effort.count(2000)) for name in _POLICIES), actions,
        limits=(
            Limit("file / learner", at_most=0.5),
            *(Limit(f"load, {steps} steps [ms]", at_most=2000, unit="ms") for steps in _REPLAYS),
        ),
        alone=True, needs=("stable_baselines3", "sb3_contrib", "onnxscript", "onnxruntime"),
    ),
    Claim(
        "policies.robot", "What a robot that runs a policy has to install and to import, and what a training has to.",
        lambda effort: ("deploy", "sb3"), environment,
        limits=(
            Limit("size [MB]", at_most=1000, unit="MB", where={"extra": "deploy"}),
            Limit(
                "import [s]", at_most=1, unit="s", where={"extra": "deploy"},
                known="Numba takes half of it, NumPy and Gymnasium a quarter, and the first frame needs them",
            ),
        ),
        alone=True, needs=("stable_baselines3", "onnxruntime"),
    ),
    Claim(
        "policies.success", "Goals that SAC with hindsight replay reaches on the cable, by its model and by its file.",
        lambda effort: ((effort.count(_TRAINING), effort.count(100)),), success,
        limits=(
            Limit("other outcome", at_most=5), Limit("file [%]", at_least=80, unit="%", sampled=0),
        ),
        needs=("mujoco", "stable_baselines3", "onnxscript", "onnxruntime"),
    ),
)  # fmt: skip
