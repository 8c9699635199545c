"""Every command: its help in 80 columns, exit code 2 for wrong usage, 1 with one line for an error."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from typing import Any

import pytest

from shape_obs.cli import COMMANDS, main
from shape_obs.cli.calibrate import CALIBRATIONS
from tests.benchmarks.cli import MEASUREMENTS

GROUPS = {"calibrate": CALIBRATIONS, "bench": MEASUREMENTS}
COMMAND_LINES = [[name] for name in COMMANDS if name not in GROUPS]
COMMAND_LINES += [[group, part] for group, parts in GROUPS.items() for part in parts]
# Wrong usage of every command: a missing or invalid value, a value out of range, options that exclude each other.
WRONG = {
    "demo": ["--steps 0", "--steps x", "--camera d435x", "--seed -1"],
    "detect": ["", "a.png", "a.png --hsv 1 2 3", "a.png --config c.yaml --pick 1,2", "a.png --pick 1,2 --n 4x",
               "a.png --pick 1", "a.png --pick 1,2 --depth d.png"],
    "tune": ["", "photos --port 70000", "photos --depth {file}", "photos --intrinsics 1 1 1 1", "photos --set a"],
    "record": ["--source d455", "--source d455 -o r --frames 0", "--source d455 -o r --set a",
               "--source photos -o r.db3"],
    "replay": ["", "rec", "rec --verify --frames 0", "rec --config {file} --csv a.npz"],
    "view": ["", "rec --out v.mp4", "rec --frames 0"],
    "extract": ["rec -o d", "--config {file} -o d", "rec --config {file} -o d --jobs 0",
                "rec --config {file} -o d --address a"],
    "fit-features": ["-o c.npz", "t.npz -o c.txt", "rec -o c.npz", "t.npz -o c.npz --components 0"],
    "goal": ["", "--frames 0 --config {file}", "--robot nothing --config {file}", "--size 640"],
    "ablate": ["", "{file}", "{file} -o o --jobs 0", "{file} -o o --address auto", "{file} -o o --engine slurm"],
    "deploy": ["", "--robot nothing", "{file} --robot a:B --controller a:C", "--robot a:B --trust",
               "--robot a:B --min-valid 2", "--robot a:B --workspace-low 0", "--robot a:B --rate 0",
               "--robot a:B --seconds 0"],
    "markers": ["-o m.txt", "--size 0", "--board 7 5 36 27", "--charuco --size 30", "--ids -1"],
    "calibrate base": ["", "--source d455 --frames 0", "--source d455 --max-rms 0", "--source d455 --set a"],
    "calibrate intrinsics": ["", "--source d455 --views 0", "--source d455 --board 7 5"],
    "bench claims": ["--only nonsense", "--share 0", "--jobs 0"],
    "bench table": ["--frames 9", "--only nonsense", "--clock sun"],
    "bench peers": ["--frames 0", "--slow-frames -1"],
    "bench latency": ["--sizes 5", "--memory -1"],
    "bench envs": ["--steps 0", "--envs Sea"],
    "bench servo": ["--goals 0", "--invalid 2", "--sizes wide"],
}  # fmt: skip
# What only running a command shows. The measurements that read no file are left out.
FAILS = {
    "demo": "--out {file}/o",
    "detect": "a.png --config none.yaml",
    "record": "--source none.db3 -o r",
    "tune": "none.png",
    "replay": "none.mp4 --verify",
    "view": "rec --config none.yaml",
    "extract": "rec --config none.yaml -o d",
    "fit-features": "none.npz -o c.npz",
    "goal": "--config none.yaml",
    "ablate": "none.yaml -o o",
    "deploy": "none.policy --robot a:B",
    "markers": "-o {file}/m.pdf",
    "calibrate base": "--source none.db3",
    "calibrate intrinsics": "--source none.db3",
    "bench claims": "--garments none.json",
    "bench table": "--out {file}/o --no-figures",
    "bench servo": "--pca none.npz",
}
SCRIPT = """
import contextlib, io, json, sys
from shape_obs.cli import main
found = []
for arguments in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(arguments)
        except SystemExit as end:
            code = end.code
    found.append([code, out.getvalue(), err.getvalue(), sorted(set(sys.modules) & set(json.loads(sys.argv[2])))])
print(json.dumps(found))
"""
SLOW = [
    "cv2", "gymnasium", "matplotlib", "mujoco", "numba", "numpy", "pandas", "pyarrow", "ray", "scipy", "sklearn",
    "stable_baselines3", "torch",
]  # fmt: skip


def run_all(lines: list[list[str]], modules: list[str], folder: Any) -> list[list[Any]]:
    """Return exit code, stdout, stderr and the modules loaded so far for each command line, in one new process."""
    script = [sys.executable, "-c", SCRIPT, json.dumps(lines), json.dumps(modules)]
    done = subprocess.run(script, capture_output=True, text=True, timeout=200, cwd=folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture
def help_of(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")

    def help_of(command: list[str]) -> str:
        with pytest.raises(SystemExit) as end:
            main([*command, "--help"])
        assert not end.value.code
        return capsys.readouterr().out

    return help_of


@pytest.mark.parametrize("command", COMMAND_LINES, ids=" ".join)
def test_help_reads_well_in_80_columns(help_of, command):
    text = help_of(command)
    assert text.startswith("usage: shape-obs " + " ".join(command))
    assert max(map(len, text.splitlines())) <= 80
    for noise in ("None", "(default: )", "(default: False)", "--no-json"):
        assert noise not in text
    boxes = re.findall(r"╭─ ([\w -]+?) ─+╮\n(.*?)╰", text, re.DOTALL)
    titles = [title for title, _ in boxes]
    assert len(set(titles)) == len(titles)
    for title, inside in boxes:
        options = re.findall(r"^│ (-[^│]*?)(?:  .*)?│$", inside, re.MULTILINE)
        if title == "options":
            assert [option.strip() for option in options] == ["-h, --help"], "every option belongs to a group"
        for option in options:
            assert not re.search(r"\b(STR|INT|FLOAT|PATH)\b", option), f"{option} shows a type"


@pytest.mark.parametrize("command", [[], *([group] for group in GROUPS)], ids=str)
def test_lists_of_commands_fit_too(help_of, command):
    text = help_of(command)
    names = GROUPS[command[0]] if command else COMMANDS
    assert max(map(len, text.splitlines())) <= 80
    assert all(f"  {name}" in text for name in names)


def test_every_command_is_tested_here():
    assert set(WRONG) == set(map(" ".join, COMMAND_LINES))
    assert set(WRONG) - set(FAILS) == {"bench peers", "bench latency", "bench envs"}


def test_wrong_usage_ends_with_2_before_anything_slow_is_imported(tmp_path):
    file = tmp_path / "file.yaml"
    file.write_text("{}")
    lines = [[*name.split(), *one.format(file=file).split()] for name, several in WRONG.items() for one in several]
    lines += [[*command, "--nonsense"] for command in COMMAND_LINES]
    lines += [["nonsense"], ["bench", "nonsense"], ["calibrate", "nonsense"]]
    for line, (code, out, err, loaded) in zip(lines, run_all(lines, SLOW, tmp_path), strict=True):
        assert (code, out) == (2, ""), line
        assert err.strip(), line
        assert not loaded, line
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file.yaml"]


def test_errors_end_with_1_and_one_line(tmp_path):
    file = tmp_path / "file.yaml"
    file.write_text("{}")
    lines = [[*name.split(), *rest.format(file=file).split()] for name, rest in FAILS.items()]
    for line, (code, out, err, loaded) in zip(lines, run_all(lines, ["torch", "mujoco"], tmp_path), strict=True):
        assert (code, out) == (1, ""), (line, err)
        assert err.count("\n") == 1, (line, err)
        assert err.startswith("shape-obs " + line[0]), line
        assert not loaded, line


def test_a_shell_sees_the_exit_codes():
    environment = {**os.environ, "COLUMNS": "80"}
    for rest, code in ((["detect", "a.png", "--config", "none.yaml"], 1), (["detect", "a.png"], 2), (["--help"], 0)):
        command = [sys.executable, "-c", "from shape_obs.cli import main; main()", *rest]
        assert subprocess.run(command, capture_output=True, env=environment, timeout=100).returncode == code
