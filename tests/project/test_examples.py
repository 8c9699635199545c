"""Every example runs as documented in its first lines and prints the documented output; so does the notebook."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import cv2
import gymnasium_gl
import numpy as np
import pytest

from shape_obs.image.click_net import CHANNELS

EXAMPLES = Path(__file__).parents[2] / "examples"
EXPECTED = {
    "first_vector.py": "observation: (60,)",
    "wrap_your_env.py": "bend 0.8: the middle lies 13",
    "detect_photo.py": "ok: True",
    "three_shapes.py": "cloth: Grid(rows=4, cols=8), ok: True",
    "several_ropes.py": "rope1: ok: True , knotted; U1- O2- U3- O1- U2- O3-",
    "point_cloud.py": "20 ordered points, gaps",
    "two_cameras.py": "camera 1: ok: True",
    "shape_goal.py": "end: is_success: True, the simulator says True",
    "markers.py": "frame 19: ok: True, markers (0, 1, 2, 3), 1.",
    "deploy_loop.py": "goal            reached",
    "foreign_env.py": "ok: True",
    "foreign_env_depth.py": "13 points in metres, ok: True",
    "shape_servo.py": "4 of 4 goals within 10 mm",
    "servo_robot.py": "goal            reached",
    "deploy_policy.py": "reads points3d every 0.05 s",
    "log_rerun.py": "found in 54 of 60 frames",
    "own_feature.py": "ok: True and within the bounds: True",
    "own_clusterer.py": "quantiles            ok: True, off by at most 1.0 px",
    "lerobot_dataset.py": "3 episodes, 75 rows at 20 Hz",
    "features_offline.py": "pca, aligned    11 values, points back within  ",
}
# The others run at night.
SMOKE = ("first_vector.py", "wrap_your_env.py", "detect_photo.py")
# Run in small by test_train_examples.py.
TRAINED = ("train_sac_her.py", "train_sac.py", "train_ppo.py", "train_cnn.py")
DRAWN_BY_GYMNASIUM = ("foreign_env.py", "foreign_env_depth.py")


def test_every_example_is_tested_and_stands_in_the_gallery_with_a_picture():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {*EXPECTED, *TRAINED}
    page = (EXAMPLES.parent / "docs" / "examples.md").read_text(encoding="utf-8")
    files = [*EXAMPLES.glob("*.py"), *EXAMPLES.glob("ablations/*.yaml"), *EXAMPLES.glob("*.ipynb")]
    missing = [path.name for path in files if f"`{path.relative_to(EXAMPLES.parent).as_posix()}`" not in page]
    assert not missing
    pictures = re.findall(r"^:img-top: (.+)$", page, re.MULTILINE)
    assert len(pictures) == len({*pictures}) == page.count("{grid-item-card}")
    for picture in pictures:
        assert (EXAMPLES.parent / "docs" / picture).stat().st_size < 40_000


@pytest.mark.parametrize(
    "name", [name if name in SMOKE else pytest.param(name, marks=pytest.mark.nightly) for name in EXPECTED]
)
def test_example_runs(name, tmp_path):
    environment = None
    if name == "log_rerun.py":
        pytest.importorskip("rerun")
    if name in DRAWN_BY_GYMNASIUM:
        if gymnasium_gl.missing():
            pytest.skip(gymnasium_gl.missing())
        environment = gymnasium_gl.environment()
    done = subprocess.run(
        [sys.executable, EXAMPLES / name],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert EXPECTED[name] in done.stdout


@pytest.mark.nightly
def test_the_training_of_the_click_network_stops_and_goes_on(tmp_path):
    torch = pytest.importorskip("torch")
    for library in ("onnx", "skimage"):
        pytest.importorskip(library)
    training = EXAMPLES / "click_net" / "train.py"
    command = [sys.executable, training, "--minutes", "0.03", "--tests", "2", "--out", tmp_path]
    progress, printed = [], []
    for _ in range(2):
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr
        printed.append(done.stdout)
        progress.append(torch.load(tmp_path / "checkpoint.pt", weights_only=True)["progress"])
    first, second = (each["step"] for each in progress)
    assert 0 < first < second
    assert f"{first} steps so far" in printed[1]
    assert [row[1] for row in progress[1]["curve"]] == [first, second]

    network = cv2.dnn.readNetFromONNX(str(tmp_path / "click_net.onnx"))
    for size in ((240, 320), (448, 336)):
        network.setInput(np.random.default_rng(0).random((1, CHANNELS, *size), np.float32))
        logits = network.forward()
        assert logits.shape == (1, 1, *size)
        assert np.isfinite(logits).all()


ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tutorials" / "first-vector.md"
NOTEBOOK = ROOT / "examples" / "first_vector.ipynb"


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_the_notebook_equals_the_page():
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    again = "run `uv run python docs/pictures/notebook.py`"
    assert ["".join(cell["source"]) for cell in cells] == [block.strip("\n") for block in blocks("python")], again
    printed = ["".join(output["text"]) for cell in cells for output in cell["outputs"] if "text" in output]
    assert printed == blocks("text"), again
    assert "image/png" in cells[-1]["outputs"][-1]["data"]
    assert not re.search(r"/(home|root|tmp|work|Users)/", "".join(printed)), "a trace of the machine that ran it"
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}
    assert NOTEBOOK.stat().st_size < 300_000


@pytest.mark.nightly
def test_the_notebook_runs(tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("ipykernel")
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    *_, last = (cell for cell in notebook.cells if cell.cell_type == "code")
    assert "image/png" in last.outputs[-1].data
