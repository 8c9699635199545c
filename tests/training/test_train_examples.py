"""Short runs of the training examples: they learn, stop, resume, and save a policy."""

from __future__ import annotations

import pickle
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
OFF_POLICY = {"learning_starts": 90, "buffer": 250}
SLOW = {"learning_starts": 190, "buffer": 250, "size": 40}  # a convolution takes its time
TINY: dict[str, dict[str, Any]] = {
    "train_sac_her": OFF_POLICY | {"goals": 1},
    "train_sac": OFF_POLICY | {"starts": 1},
    "train_ppo": {"envs": 2, "rollout": 25, "starts": 1},
    "train_cnn": SLOW | {"goals": 1},
}


def example(name: str) -> Any:
    spec = spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def unpickled(path: Path) -> Any:
    with path.open("rb") as file:
        return pickle.load(file)


@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore:rich is", "ignore:The last trajectory", "ignore:You have specified a mini-batch")
@pytest.mark.parametrize("name", TINY)
def test_a_training_stops_and_goes_on(name, tmp_path, capsys):
    pytest.importorskip("mujoco")
    pytest.importorskip("stable_baselines3")
    import torch
    from stable_baselines3.common.save_util import load_from_zip_file

    from shape_obs.deploy.policy_bundle import load_bundle

    threads = torch.get_num_threads()
    module = example(name)
    tiny = TINY[name] | {"out": tmp_path / "run", "evaluate_every": 100, "checkpoint_every": 100}
    module.main(module.Args(steps=100, **tiny))
    module.main(module.Args(steps=200, resume=True, **tiny))
    torch.set_num_threads(threads)

    run = tmp_path / "run"
    assert "after 200 steps" in capsys.readouterr().out
    first, last = ({"at": at, "data": load_from_zip_file(run / f"model_{at}_steps.zip")[0]} for at in (100, 200))
    for saved in (first, last):
        at, data = saved["at"], saved["data"]
        assert data is not None
        assert data["num_timesteps"] == at
        # One observation more than steps, that of a reset, in each start of each env.
        count = next(iter(unpickled(run / f"model_vecnormalize_{at}_steps.pkl").obs_rms.values())).count
        assert at <= count <= at + 5
        if name != "train_ppo":
            # What was seen before is still known; the step of the checkpoint itself comes in after it.
            buffer = unpickled(run / f"model_replay_buffer_{at}_steps.pkl")
            assert at - 2 <= (buffer.buffer_size if buffer.full else buffer.pos) <= at
    assert list(run.glob("*_1/events.out.tfevents.*"))
    assert load_bundle(run / "cable.policy").record.summary["steps"] == 200
