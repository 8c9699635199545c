"""``--help`` does not load the libraries that only the command itself needs."""

from __future__ import annotations

import subprocess
import sys
from typing import get_args, get_type_hints

import pytest

from shape_obs.cli import COMMANDS
from shape_obs.cli.calibrate import CALIBRATIONS

GROUPS = {"calibrate": CALIBRATIONS}
# Not rich: old versions of tyro write their help with it.
HEAVY = {
    "PIL", "cv2", "gymnasium", "joblib", "matplotlib", "mujoco", "numba", "numpy", "pandas",
    "pyarrow", "pyrealsense2", "ray", "rerun", "scipy", "shape_obs_envs", "sklearn", "stable_baselines3", "torch",
    "tqdm", "yaml",
}  # fmt: skip
SCRIPT = """
import sys
from shape_obs.cli import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    assert not end.code, end.code
print("LOADED", *sorted(sys.modules))
"""


def commands() -> list[list[str]]:
    alone = [[name] for name in COMMANDS if name != "bench"]
    return alone + [[group, part] for group, parts in GROUPS.items() for part in parts]


@pytest.mark.parametrize("command", commands(), ids=" ".join)
def test_help_loads_only_the_options(command):
    script = [sys.executable, "-c", SCRIPT, *command, "--help"]
    done = subprocess.run(script, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    text, _, loaded = done.stdout.rpartition("LOADED")
    assert "usage: shape-obs " + " ".join(command) in text
    modules = set(loaded.split())
    assert not modules & HEAVY
    # Of the package, only the command line and the lowest layer.
    ours = {name for name in modules if name.startswith("shape_obs.")}
    assert {name for name in ours if not name.startswith(("shape_obs.cli", "shape_obs.utils"))} == set()
    assert not ours & {"shape_obs.utils.arrays", "shape_obs.utils.threads"}


def test_values_repeated_for_help_are_those_of_the_library():
    from shape_obs.cli import fit_features, markers, options, record
    from shape_obs.features.coordinates import CoordinateFrame
    from shape_obs.markers import DICTIONARY
    from shape_obs.markers.sheet import Paper
    from shape_obs.recording.record import Depth

    assert options.DICTIONARY == DICTIONARY
    assert get_args(get_type_hints(markers.Arguments)["paper"]) == get_args(Paper)
    assert get_args(get_type_hints(record.Arguments)["depth"]) == get_args(Depth)
    types = get_type_hints(fit_features.Arguments, {"Path": object, **vars(fit_features)})
    assert get_args(types["frame"]) == get_args(CoordinateFrame)
