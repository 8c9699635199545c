"""The package as it is installed and published: names, versions, extras, files, and what an import loads."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import metadata, util
from pathlib import Path
from typing import Any

import pytest
import yaml

import shape_obs

ROOT = Path(__file__).parents[2]
HEAVY = {"cv2", "gymnasium", "joblib", "matplotlib", "mujoco", "numba", "numpy", "pandas", "pyrealsense2", "ray",
         "scipy", "sklearn", "stable_baselines3", "torch", "tyro", "yaml"}  # fmt: skip
NOT_THE_CORE = {"gymnasium", "joblib", "matplotlib", "mujoco", "pyrealsense2", "ray", "sklearn", "stable_baselines3",
                "shape_obs_envs", "torch", "tyro"}  # fmt: skip


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def requirements() -> list[str]:
    return metadata.requires("shape-obs") or []


@pytest.fixture(scope="module")
def pyproject() -> dict[str, Any]:
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 reads no TOML")
    return tomllib.loads(read("pyproject.toml"))


# ---- what is installed


def test_the_version_is_one():
    assert metadata.version("shape-obs") == shape_obs.__version__
    assert f"## [{shape_obs.__version__}]" in read("CHANGELOG.md")


def test_the_command_is_installed():
    (command,) = metadata.entry_points(group="console_scripts", name="shape-obs")
    assert callable(command.load())


def test_all_is_every_extra_and_old_names_stay():
    extras = set(metadata.metadata("shape-obs").get_all("Provides-Extra") or ())
    of = {extra: {line.split(";")[0] for line in requirements() if f"extra == '{extra}'" in line} for extra in extras}
    assert of["all"] == set().union(*(of[extra] for extra in extras - {"all"}))
    assert {extra for extra in extras if not of[extra]} == {"fast"}  # kept for old install commands
    assert extras >= {"sim", "realsense", "sb3", "viz", "video", "parquet", "view", "tune", "rerun", "ros", "ray"}


def test_there_are_floors_but_no_upper_bounds():
    for line in requirements():
        wanted = line.split(";")[0]
        assert not re.search("<|==|~=", wanted), line
        assert ">=" in wanted, line


def test_nothing_brings_a_second_opencv():
    names = {re.split(r"[\s\[<>=;!~]", line)[0] for line in requirements()}
    assert "opencv-python-headless" in names
    assert not names & {"opencv-python", "opencv-contrib-python"}
    assert not any("stable-baselines3[" in line for line in requirements())


def test_every_public_name_is_there_and_an_unknown_one_gets_a_hint():
    for name in shape_obs.__all__:
        assert getattr(shape_obs, name).__name__ == name
    assert {"ShapeDetector", *shape_obs.__all__} <= set(dir(shape_obs))
    message = r"module 'shape_obs' has no attribute 'ShapeDetecter'; it has: .*ShapeDetector"
    with pytest.raises(AttributeError, match=message):
        shape_obs.ShapeDetecter  # noqa: B018


# ---- what an import loads

WALK = """
import importlib, pkgutil
def load(package, skip=()):
    for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
        if module.name not in skip:
            loaded = importlib.import_module(module.name)
            if module.ispkg:
                load(loaded, skip)
import shape_obs
load(shape_obs, {skip})
"""
# A network's part is a class of torch's, so its file begins with it; nothing else loads that file while loading.
TORCH_PARTS = ("shape_obs.policy.learner", "shape_obs.training.extractors", "shape_obs.training.pixel_policy")
APPLICATIONS = ("shape_obs.wrappers", "shape_obs.training", "shape_obs.policy", "shape_obs.ablation",
                "shape_obs.extraction", "shape_obs.tuner", "shape_obs.cli")  # fmt: skip


@pytest.mark.parametrize(
    ("statement", "forbidden"),
    [
        ("import shape_obs; shape_obs.__version__; dir(shape_obs); import shape_obs.cli, shape_obs.spec", HEAVY),
        ("import shape_obs.detector, shape_obs.config.config_file, shape_obs.features, shape_obs.camera", NOT_THE_CORE),
        ("from shape_obs import *; import shape_obs.wrappers", NOT_THE_CORE - {"gymnasium"}),
        ("import shape_obs_envs", HEAVY - {"gymnasium", "numpy"}),
        (WALK.replace("{skip}", repr(APPLICATIONS)), {"gymnasium", "sklearn", "tyro", "matplotlib"}),
        # Some versions of NiceGUI, which only the tuner loads, load Matplotlib.
        (
            WALK.replace("{skip}", repr((*TORCH_PARTS, "shape_obs.tuner"))),
            {"shape_obs_envs", "mujoco", "torch", "stable_baselines3", "pyrealsense2", "matplotlib"},
        ),
    ],
    ids=["shape_obs", "core", "wrappers", "envs", "all but applications", "all"],
)
def test_an_import_stays_light(statement, forbidden):
    script = f"{statement}\nimport sys\nprint(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert not set(done.stdout.split()) & forbidden


# ---- the files for publishing


def test_the_citation_is_valid_and_of_this_version(pyproject):
    citation = yaml.safe_load(read("CITATION.cff"))
    assert citation.keys() >= {"cff-version", "message", "title", "authors"}
    assert (citation["cff-version"], citation["type"]) == ("1.2.0", "software")
    for key in ("version", "license", "authors"):
        assert citation[key] == pyproject["project"][key]
    (paper,) = citation["references"]
    assert paper.keys() >= {"type", "title", "authors"}
    assert paper["title"] in " ".join(read("README.md").split())


def test_the_badges_match_the_project(pyproject):
    spec = util.spec_from_file_location("badges", ROOT / "docs" / "pictures" / "badges.py")
    assert spec is not None
    assert spec.loader is not None
    script = util.module_from_spec(spec)
    spec.loader.exec_module(script)
    drawn = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "docs/images/badges").glob("*.svg")}
    assert drawn == script.badges(), "run `uv run python docs/pictures/badges.py`"
    assert pyproject["project"]["version"] in drawn["version"]
    with pytest.raises(ValueError, match="disagree"):
        script.facts({**pyproject["project"], "requires-python": ">=3.9"})


def test_the_image_has_extras_a_python_and_files_that_exist(pyproject):
    lines, project = read("Dockerfile").splitlines(), pyproject["project"]
    (extras,) = (line.removeprefix("ARG EXTRAS=") for line in lines if line.startswith("ARG EXTRAS="))
    assert set(extras.split(",")) <= set(project["optional-dependencies"])
    (python,) = (line.removeprefix("FROM python:").removesuffix("-slim") for line in lines if line.startswith("FROM"))
    assert f"Programming Language :: Python :: {python}" in project["classifiers"]
    assert any(line.startswith("USER ") and line != "USER root" for line in lines)
    copied = {word for line in lines if line.startswith("COPY ") for word in line.split()[1:-1]}
    needed = {"pyproject.toml", project["readme"], *project["license-files"]}
    needed |= {package.split("/")[0] for package in pyproject["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]}
    assert needed <= copied
    assert {line[1:] for line in read(".dockerignore").splitlines() if line.startswith("!")} == copied
    assert all((ROOT / name).exists() for name in copied)


def test_the_source_distribution_holds_what_these_tests_read(pyproject):
    included = set(pyproject["tool"]["hatch"]["build"]["targets"]["sdist"]["include"])
    assert included >= {"/CITATION.cff", "/CONTRIBUTING.md", "/Dockerfile", "/.dockerignore", "/tests", "/docs"}
    assert all((ROOT / name[1:]).exists() for name in included)
