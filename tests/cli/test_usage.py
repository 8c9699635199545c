"""Every command: its help in 80 columns, exit code 2 for wrong usage, 1 with one line for an error."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args, get_type_hints

import cv2
import numpy as np
import pytest

from shape_obs.cli import COMMANDS, main
from shape_obs.cli.bench import MEASUREMENTS
from shape_obs.cli.calibrate import CALIBRATIONS

GROUPS = {"calibrate": CALIBRATIONS, "bench": MEASUREMENTS}
COMMAND_LINES = [name for name in COMMANDS if name not in GROUPS]
COMMAND_LINES += [f"{group} {part}" for group, parts in GROUPS.items() for part in parts]
# Wrong usage of every command: a missing or invalid value, a value out of range, options that exclude each other.
WRONG = {
    "demo": ["--steps 0", "--steps x", "--camera d435x", "--seed -1"],
    "detect": ["", "a.png", "a.png --hsv 1 2 3", "a.png --config c.yaml --pick 1,2", "a.png --pick 1,2 --n 4x",
               "a.png --pick 1", "a.png --pick 1,2 --depth d.png", "a.png --pick 1,2 --count many",
               "a.png --pick 1,2 --depth d.png e.png", "a.png --pick 1,2 --shape surface --n 20",
               "a.png --hsv 1 2 3 4 5 6 --save-config s.yaml", "a.png --pick 1,2 --shape contour --ends tips"],
    "tune": ["", "photos --port 70000", "photos --depth {file}", "photos --intrinsics 1 1 1 1", "photos --set a"],
    "record": ["--source d455", "--source d455 -o r --frames 0", "--source d455 -o r --set a",
               "--source photos -o r.db3"],
    "replay": ["", "rec", "rec --verify --frames 0", "rec --config {file} --csv a.npz",
               "rec --config {file} --npz a.csv", "rec --verify --csv a.csv"],
    "view": ["", "rec --out v.mp4", "rec --frames 0"],
    "extract": ["rec -o d", "--config {file} -o d", "rec --config {file} -o d --jobs 0",
                "rec --config {file} -o d --address a"],
    "fit-features": ["-o c.npz", "t.npz -o c.txt", "rec -o c.npz", "t.npz -o c.npz --components 0",
                     "t.npz -o c.npz --set a=1"],
    "goal": ["", "--frames 0 --config {file}", "--robot nothing --config {file}", "--size 640"],
    "ablate": ["", "{file}", "{file} -o o --jobs 0", "{file} -o o --address auto", "{file} -o o --engine slurm"],
    "deploy": ["", "--robot nothing", "{file} --robot a:B --controller a:C", "--robot a:B --trust",
               "--robot a:B --min-valid 2", "--robot a:B --workspace-low 0", "--robot a:B --rate 0",
               "--robot a:B --seconds 0", "--robot a:B --record r --log r/log"],
    "markers": ["-o m.txt", "--size 0", "--board 7 5 36 27", "--charuco --size 30", "--ids -1"],
    "calibrate base": ["", "--source d455 --frames 0", "--source d455 --max-rms 0", "--source d455 --set a"],
    "calibrate intrinsics": ["", "--source d455 --views 0", "--source d455 --board 7 5"],
    "bench speed": ["--frames 0", "--sizes 5x5", "--envs Sea", "--clock sun"],
    "bench table": ["--frames 9", "--only nonsense", "--clock sun"],
}  # fmt: skip
# What only running a command shows.
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
    "bench table": "--out {file}/o",
}
# Not rich: old versions of tyro write their help with it.
HEAVY = [
    "PIL", "cv2", "gymnasium", "joblib", "matplotlib", "mujoco", "numba", "numpy", "pandas", "pyarrow",
    "pyrealsense2", "ray", "rerun", "scipy", "shape_obs_envs", "sklearn", "stable_baselines3", "torch", "tqdm",
]  # fmt: skip
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
    found.append([code or 0, out.getvalue(), err.getvalue(), sorted(set(sys.modules) & set(json.loads(sys.argv[2])))])
print(json.dumps(found))
"""


def run_all(lines: list[list[str]], folder: Any) -> list[list[Any]]:
    """Return exit code, stdout, stderr and the heavy modules loaded so far of each command line, in a new process."""
    script = [sys.executable, "-c", SCRIPT, json.dumps(lines), json.dumps(HEAVY)]
    wide = {**os.environ, "COLUMNS": "80"}
    done = subprocess.run(script, capture_output=True, text=True, timeout=200, cwd=folder, env=wide)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def check_help(command: str, text: str) -> None:
    assert text.startswith(f"usage: shape-obs {command}")
    assert max(map(len, text.splitlines())) <= 80, command
    for noise in ("None", "(default: )", "(default: False)", "--no-json"):
        assert noise not in text, command
    boxes = re.findall(r"╭─ ([\w -]+?) ─+╮\n(.*?)╰", text, re.DOTALL)
    titles = [title for title, _ in boxes]
    assert len(set(titles)) == len(titles), command
    for title, inside in boxes:
        options = re.findall(r"^│ (-[^│]*?)(?:  .*)?│$", inside, re.MULTILINE)
        if title == "options":
            assert [option.strip() for option in options] == ["-h, --help"], f"{command}: every option has a group"
        for option in options:
            assert not re.search(r"\b(STR|INT|FLOAT|PATH)\b", option), f"{command}: {option} shows a type"


def test_help_reads_well_in_80_columns_and_loads_only_the_options(tmp_path):
    lists: dict[str, Any] = {"": COMMANDS, **GROUPS}
    names = [*COMMAND_LINES, *lists]
    results = run_all([[*name.split(), "--help"] for name in names], tmp_path)
    for name, (code, text, err, loaded) in zip(names, results, strict=True):
        assert (code, err, loaded) == (0, "", []), name
        if name in lists:
            assert max(map(len, text.splitlines())) <= 80
            assert all(f"  {part}" in text for part in lists[name])
        else:
            check_help(name, text)


def test_every_command_is_tested_here():
    assert set(WRONG) == {*FAILS, "bench speed"} == set(COMMAND_LINES)  # which reads and writes no file


def test_wrong_usage_ends_with_2_before_anything_slow_is_imported(tmp_path, run, monkeypatch):
    file = tmp_path / "file.yaml"
    file.write_text("{}")
    lines = [[*name.split(), *one.format(file=file).split()] for name, several in WRONG.items() for one in several]
    lines += [[*command.split(), "--nonsense", "a.png"] for command in COMMAND_LINES]
    lines += [["nonsense"], ["calibrate", "nonsense"]]
    for line, (code, out, err, loaded) in zip(lines, run_all(lines, tmp_path), strict=True):
        assert (code, out) == (2, ""), line
        assert err.count("\n") == 1 if "--nonsense" in line else err.strip(), line
        assert not loaded, line
    assert [path.name for path in tmp_path.iterdir()] == ["file.yaml"]
    monkeypatch.chdir(tmp_path)
    assert {run(*line)[0] for line in lines} == {2}, "in a process that has run commands before"


@pytest.mark.parametrize("name", FAILS)
def test_errors_end_with_1_and_one_line(run, name, tmp_path, monkeypatch):
    file = tmp_path / "file.yaml"
    file.write_text("{}")
    monkeypatch.chdir(tmp_path)
    code, out, err = run(*name.split(), *FAILS[name].format(file=file).split())
    assert (code, out) == (1, ""), err
    assert err.count("\n") == 1
    assert err.startswith("shape-obs " + name.split()[0])


def test_a_shell_sees_the_exit_code_of_the_installed_command_and_a_hint():
    command = [Path(sys.executable).with_name("shape-obs"), "detekt"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100)
    assert (done.returncode, done.stdout) == (2, "")
    assert "unknown command 'detekt'; did you mean 'detect'?" in done.stderr


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


@pytest.mark.parametrize("words", [[], ["bench"], ["calibrate", "--help"]])
def test_without_a_command_all_are_listed(words, run):
    code, listed, _ = run(*words)
    assert code == 0
    assert all(f"  {name} " in listed for name in (GROUPS[words[0]] if words else COMMANDS))


def test_a_part_that_does_not_exist_is_wrong_usage_and_the_nearest_is_named(run):
    code, _, err = run("bench", "sped")
    assert code == 2
    assert "speed" in err


@pytest.mark.parametrize("arguments", [["detect", "--help"], ["--help"], ["--version"], ["detect", "none.png"], ["x"]])
@pytest.mark.parametrize("missing", ["stdout", "stderr", "both"])
def test_it_runs_without_output_streams_as_in_pythonw_and_after_its_reader_has_ended(monkeypatch, arguments, missing):
    def run() -> object:
        with pytest.raises(SystemExit) as stop:
            main(arguments)
        return stop.value.code

    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.StringIO() if missing not in (name, "both") else None)
    other = [stream for stream in (sys.stdout, sys.stderr) if isinstance(stream, io.StringIO)]
    code = run()
    assert code == (2 if arguments[0] in ("detect", "x") and "--help" not in arguments else 0)
    for stream in other:  # what belongs to the other stream is not printed here
        assert bool(stream.getvalue()) == ((code == 0) == (missing == "stderr"))
    reader, writer = os.pipe()
    os.close(reader)
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, os.fdopen(os.dup(writer), "w"))
    assert run() == 1
    raw = os.fdopen(os.dup(writer), "wb", 0)  # as with PYTHONUNBUFFERED
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, write_through=True))
    monkeypatch.setattr(sys, "stderr", errors := io.StringIO())
    assert run() == (code or 1)
    assert "pipe" not in errors.getvalue()
    os.close(writer)


def test_what_a_stream_cannot_encode_is_printed_as_codes(tmp_path, monkeypatch):
    (tmp_path / "Knöpfe").mkdir()
    cv2.imwrite(str(tmp_path / "p.png"), np.zeros((20, 20, 3), np.uint8))
    (tmp_path / "p.png").rename(tmp_path / "Knöpfe" / "p.png")
    monkeypatch.chdir(tmp_path)
    output = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(output, "ascii"))
    with pytest.raises(SystemExit) as stop:
        main(["replay", "Knöpfe", "--verify"])
    assert stop.value.code == 0
    assert output.getvalue().startswith(b"source          Kn\\xf6pfe")


def test_help_has_its_texts_where_docstrings_are_removed(tmp_path):
    for flags in (["-OO"], ["-I"], ["-W", "error"]):
        command = [sys.executable, *flags, "-c", "from shape_obs.cli import main; main()", "detect", "--help"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=100, cwd=tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        assert "Find the shape in image files." in done.stdout
        assert "Annotated[" not in done.stdout
