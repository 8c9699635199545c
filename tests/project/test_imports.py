"""The modules that an import may load, each tested in a separate process."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("cv2", "gymnasium", "joblib", "matplotlib", "mujoco", "numba", "numpy", "pandas", "pyrealsense2", "ray",
         "scipy", "sklearn", "stable_baselines3", "torch", "tyro", "yaml")  # fmt: skip
NOT_THE_CORE = ("gymnasium", "joblib", "matplotlib", "mujoco", "pyrealsense2", "ray", "sklearn", "stable_baselines3",
                "shape_obs_envs", "torch", "tyro")  # fmt: skip


def loaded(statement: str) -> set[str]:
    script = f"{statement}\nimport sys\nprint(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize(
    ("statement", "forbidden"),
    [
        ("import shape_obs; shape_obs.__version__; dir(shape_obs)", HEAVY),
        ("import shape_obs.cli", HEAVY),
        ("import shape_obs.spec", HEAVY),
        ("import shape_obs.detector, shape_obs.config.config_file, shape_obs.features, shape_obs.camera", NOT_THE_CORE),
        ("from shape_obs import *; import shape_obs.wrappers", tuple(set(NOT_THE_CORE) - {"gymnasium"})),
        (
            "import shape_obs_envs",
            ("cv2", "mujoco", "torch", "sklearn", "matplotlib", "pyrealsense2", "stable_baselines3"),
        ),
    ],
    ids=["shape_obs", "cli", "spec", "core", "wrappers", "envs"],
)
def test_an_import_stays_light(statement, forbidden):
    assert not loaded(statement) & set(forbidden)


def test_every_public_name_is_there():
    import shape_obs

    assert "ShapeDetector" in shape_obs.__all__
    for name in shape_obs.__all__:
        assert getattr(shape_obs, name).__name__ == name
    assert set(shape_obs.__all__) <= set(dir(shape_obs))


def test_the_error_for_an_unknown_name_lists_the_known_ones():
    import shape_obs

    with pytest.raises(
        AttributeError, match=r"module 'shape_obs' has no attribute 'ShapeDetecter'; it has: .*ShapeDetector"
    ):
        shape_obs.ShapeDetecter  # noqa: B018
