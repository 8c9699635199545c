"""The cache of compiled functions, with three functions that compile in a second; no live frame compiles any."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from shape_obs.compiled.cache import cache_folder

HELPERS = """
from shape_obs.compiled import compiled
FACTOR = {factor}

@compiled
def scaled(x):
    '''{doc}'''
    return FACTOR * x
"""
FUNCTIONS = """
import numpy as np
from shape_obs.compiled import compiled
from helpers import scaled

@compiled("(f8[::1], f8)", "(f8[:,::1], f8)")
def total(values, share):
    whole = 0.0
    for value in values.flat:
        whole += scaled(value) * share
    return whole

@compiled("(f8[::1],)")
def twice(values):
    out = np.empty(len(values))
    for i in range(len(values)):
        out[i] = 2 * total(values, 1.0)
    return out
"""
# Collects the names of the functions that a process compiles.
COUNT = """
import sys, numba.core.event as event
class Count(event.Listener):
    names = []
    def on_start(self, ev):
        f = ev.data["dispatcher"].py_func
        if f.__module__ in ("functions", "helpers"): self.names.append(f.__name__)
    def on_end(self, ev): pass
event.register("numba:compile", Count())
import numpy as np, functions
from shape_obs.compiled import compile_now
"""
ALL = (
    "compile_now([functions.total, functions.twice])\n"
    "print(sorted(Count.names), functions.total(np.ones(2), 1), functions.twice(np.ones(2))[0])"
)
LAZY = "print(functions.total(np.ones(2), 1), functions.twice(np.ones(2))[0], sorted(Count.names))"
EVERYTHING = "['scaled', 'total', 'total', 'twice'] 6.0 12.0"

pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def work(tmp_path):
    (tmp_path / "helpers.py").write_text(HELPERS.format(factor=3, doc="a"))
    (tmp_path / "functions.py").write_text(FUNCTIONS)
    return tmp_path


def start(work, code, **variables):
    environment = {**os.environ, "PYTHONPATH": str(work), "NUMBA_CACHE_DIR": str(work / "cache")}
    environment |= {"PYTHONDONTWRITEBYTECODE": "1", "PYTHONWARNINGS": "default", **variables}
    return subprocess.Popen(
        [sys.executable, "-c", COUNT + textwrap.dedent(code)],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def run(work, code, **variables):
    process = start(work, code, **variables)
    out, err = process.communicate(timeout=200)
    assert process.returncode == 0, err
    return out.strip(), err


def files(work, pattern):
    return list((work / "cache" / "shape_obs").glob(pattern))


def test_functions_are_compiled_once_and_then_loaded_without_a_word(work):
    assert run(work, ALL)[0] == EVERYTHING
    assert run(work, ALL) == ("[] 6.0 12.0", "")
    assert run(work, LAZY)[0] == "6.0 12.0 []"


def test_an_edit_of_a_constant_in_another_file_is_noticed(work):
    run(work, ALL)
    (work / "helpers.py").write_text(HELPERS.format(factor=5, doc="a"))
    assert run(work, ALL)[0].endswith("10.0 20.0")


def test_a_function_that_moved_to_another_file_is_compiled_again(work):
    run(work, ALL)
    (work / "helpers.py").rename(work / "others.py")
    (work / "functions.py").write_text(FUNCTIONS.replace("from helpers", "from others"))
    out, err = run(work, ALL)
    assert out.endswith("6.0 12.0")
    assert "total" in out, "its caller is compiled, not loaded from a file that refers to the old place"
    assert err == ""


def test_a_damaged_file_is_written_again(work):
    run(work, ALL)
    for path in files(work, "functions.t*"):
        path.write_bytes(path.read_bytes()[:-3000] + bytes(2000))
    assert run(work, ALL)[0] == EVERYTHING
    assert run(work, ALL)[0] == "[] 6.0 12.0"


def test_a_cache_folder_that_cannot_be_written_gives_one_warning(work):
    (work / "file").write_text("")
    out, err = run(work, ALL, NUMBA_CACHE_DIR=str(work / "file"))
    assert out == EVERYTHING
    assert err.count("Compiled functions cannot be kept") == 1
    assert "NUMBA_CACHE_DIR" in err


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="users of POSIX")
@pytest.mark.parametrize("home", [None, "/proc/none"])
@pytest.mark.parametrize("temporary", ["there", "open to all", "missing"])
def test_without_a_home_a_folder_of_this_user_alone_is_used(tmp_path, monkeypatch, recwarn, home, temporary):
    """As in a container: a user without an entry in passwd, no HOME, a HOME that cannot be written."""

    def no_entry(uid):
        raise KeyError("getpwuid(): uid not found")

    monkeypatch.setattr("pwd.getpwuid", no_entry)
    for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    if home is not None:
        monkeypatch.setenv("HOME", home)
    own = tmp_path / f"shape_obs-{os.getuid()}"
    if temporary == "open to all":
        own.mkdir()
        own.chmod(0o777)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "none" if temporary == "missing" else tmp_path))
    cache_folder.cache_clear()
    try:
        assert cache_folder() == (own if temporary == "there" else None)
    finally:
        cache_folder.cache_clear()
    said = " ".join(str(each.message) for each in recwarn if "NUMBA_CACHE_DIR" in str(each.message))
    assert bool(said) == (temporary != "there")
    assert temporary != "there" or own.stat().st_mode & 0o777 == 0o700


def test_a_cache_that_was_filled_before_is_read_where_it_cannot_be_written(tmp_path, monkeypatch):
    """As one in the image of a container, of another user or on a read-only disk."""

    def refuse(**_):
        raise OSError(30, "Read-only file system")

    (tmp_path / "shape_obs").mkdir()
    (tmp_path / "shape_obs" / "a.bin").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("os.access", lambda *_: False)
    monkeypatch.setattr("tempfile.TemporaryFile", refuse)
    cache_folder.cache_clear()
    try:
        assert cache_folder() == tmp_path / "shape_obs"
    finally:
        cache_folder.cache_clear()


@pytest.mark.nightly
def test_nothing_is_written_next_to_the_source(work):
    """A package folder may be read-only or shared: the user's folder for caches is used."""
    home = {"HOME": str(work / "home"), "XDG_CACHE_HOME": str(work / "home" / "cache"), "NUMBA_CACHE_DIR": ""}
    home |= {"LOCALAPPDATA": str(work / "home" / "local")}
    before = {path.name for path in work.iterdir()}
    assert run(work, ALL, **home)[0] == EVERYTHING
    assert {path.name for path in work.iterdir()} == before | {"home"}
    assert run(work, ALL, **home)[0] == "[] 6.0 12.0"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_of_eight_forked_processes_one_compiles(work):
    code = f"""
import os
children = []
for _ in range(8):
    pid = os.fork()
    if pid == 0:
{textwrap.indent(ALL, "        ")}
        sys.stdout.flush()
        os._exit(0)
    children.append(pid)
for pid in children:
    assert os.waitpid(pid, 0)[1] == 0
"""
    out, _ = run(work, code)
    assert out.count("6.0 12.0") == 8
    assert out.count("twice") == 1


@pytest.mark.nightly
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
def test_the_lock_of_a_killed_compiler_is_free(work):
    slow = """
import shape_obs.compiled.decorator as d, time
prepare = d._prepare
def slowly(entry):
    prepare(entry)
    print("one", flush=True)
    time.sleep(60)
d._prepare = slowly
"""
    first = start(work, slow + ALL)
    assert first.stdout is not None
    assert first.stdout.readline().strip() == "one"
    others = [start(work, ALL) for _ in range(3)]
    for other in others:
        assert other.stderr is not None
        assert "waiting for another process" in other.stderr.readline()
    assert all(process.poll() is None for process in others)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    found = [process.communicate(timeout=200)[0] for process in others]
    assert all(out.strip().endswith("6.0 12.0") for out in found), found
    assert sum("'twice'" in out for out in found) == 1  # the next one goes on with what is left
    assert not any("'total'" in out for out in found)


SCRIPT = Path(__file__).parents[1] / "support" / "live_frames.py"


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_detectors_call_only_functions_that_their_constructors_have_prepared(tmp_path):
    """The cache is empty at first: everything is compiled from scratch, once for the three configurations."""
    for kind in ("centerline", "contour", "surface"):
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        done = subprocess.run([sys.executable, SCRIPT, kind], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        found = json.loads(done.stdout)
        assert found["late"] == []
        assert found["called"] == found["listed"]
        assert found["ok"] > 50
        assert "shape_obs: compiling" in done.stderr
