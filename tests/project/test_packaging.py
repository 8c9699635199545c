"""The package as it is installed: names, versions, extras, and who may import whom while running."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import shape_obs

ROOT = Path(__file__).parents[2]


def requirements() -> list[str]:
    return metadata.requires("shape-obs") or []


def test_the_version_is_one():
    assert metadata.version("shape-obs") == shape_obs.__version__
    assert f"## [{shape_obs.__version__}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_command_is_installed():
    (command,) = metadata.entry_points(group="console_scripts", name="shape-obs")
    assert callable(command.load())


def test_both_packages_say_that_they_are_typed():
    import shape_obs_envs

    for package in (shape_obs, shape_obs_envs):
        assert (Path(str(package.__file__)).parent / "py.typed").exists()


def test_all_is_every_extra():
    extras = set(metadata.metadata("shape-obs").get_all("Provides-Extra") or ())
    assert extras == {
        "sim",
        "realsense",
        "sb3",
        "fast",
        "viz",
        "video",
        "parquet",
        "view",
        "tune",
        "rerun",
        "ros",
        "ray",
        "all",
    }
    of = {extra: {line.split(";")[0] for line in requirements() if f"extra == '{extra}'" in line} for extra in extras}
    assert of["all"] == set().union(*(of[extra] for extra in extras - {"all"}))
    assert {extra for extra in extras if not of[extra]} == {"fast"}  # kept for old install commands


def test_floors_but_no_upper_bounds():
    for line in requirements():
        wanted = line.split(";")[0]
        assert not re.search("<|==|~=", wanted), line
        assert ">=" in wanted, line


def test_nothing_brings_a_second_opencv():
    names = {re.split(r"[\s\[<>=;!~]", line)[0] for line in requirements()}
    assert "opencv-python-headless" in names
    assert not names & {"opencv-python", "opencv-contrib-python"}
    assert not any("stable-baselines3[" in line for line in requirements())


WALK = """
import importlib, pkgutil, sys
import shape_obs

def load(package, skip=()):
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if module.name not in skip:
            loaded = importlib.import_module(module.name)
            if module.ispkg:
                load(loaded, skip)

load(shape_obs, sys.argv[1].split(","))
print(*sorted({name.split(".")[0] for name in sys.modules}))
"""


def loaded_by_all_but(*skip: str) -> set[str]:
    done = subprocess.run([sys.executable, "-c", WALK, ",".join(skip)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def test_no_module_of_the_core_loads_gymnasium():
    loaded = loaded_by_all_but(
        "shape_obs.wrappers", "shape_obs.training", "shape_obs.deploy.policy_bundle", "shape_obs.ablation",
        "shape_obs.extraction", "shape_obs.tuner", "tests.benchmarks", "shape_obs.cli",
    )  # fmt: skip
    assert not loaded & {"gymnasium", "sklearn", "tyro", "matplotlib"}


def test_applications_load_environments_inside_functions_only():
    heavy = {"shape_obs_envs", "mujoco", "torch", "stable_baselines3", "pyrealsense2", "matplotlib"}
    # A network's part is a class of torch's, so its file begins with it; nothing else loads that file while loading.
    torch_parts = ("shape_obs.training.extractors", "shape_obs.training.pixel_policy")
    # Some versions of NiceGUI load Matplotlib where it is installed; only the tuner loads NiceGUI.
    assert not loaded_by_all_but(*torch_parts, "shape_obs.tuner") & heavy
    assert not loaded_by_all_but(*torch_parts) & (heavy - {"matplotlib"})
