"""Files are written whole or not at all, to where the name leads, with the permissions that ``open`` would give."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from shape_obs import save_config
from shape_obs.utils.files import inside, write_text, write_whole


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


# ---- links


@pytest.mark.parametrize(("relative", "dangling"), [(True, False), (False, True)])
def test_a_link_stays_and_its_file_is_replaced(tmp_path, relative, dangling):
    (tmp_path / "shared").mkdir()
    file, link = tmp_path / "shared" / "c.yaml", tmp_path / "c.yaml"
    if not dangling:
        file.write_text("before")
    link.symlink_to("shared/c.yaml" if relative else file)
    save_config(link, {"dt": 0.25})
    assert link.is_symlink()
    assert "dt: 0.25" in file.read_text()
    assert names(tmp_path) == ["c.yaml", "shared"]
    assert names(file.parent) == ["c.yaml"]


def test_a_link_to_a_link_and_one_in_a_circle(tmp_path):
    (tmp_path / "one").symlink_to("two")
    (tmp_path / "two").symlink_to("three")
    write_text(tmp_path / "one", "text")
    assert (tmp_path / "three").read_text() == "text"
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(OSError, match=r"cannot write .*/a: its symbolic links lead in a circle"):
        write_text(tmp_path / "a", "text")
    assert (tmp_path / "a").is_symlink()


def test_a_name_that_can_be_guessed_is_no_way_to_another_file(tmp_path):
    """The links have the names of temporary files of earlier versions, made from the process's number."""
    (tmp_path / "precious").write_text("mine")
    for name in (f".{os.getpid()}.c.txt", f".c.txt.{os.getpid()}", ".c.txt"):
        (tmp_path / name).symlink_to(tmp_path / "precious")
    write_text(tmp_path / "c.txt", "new")
    assert (tmp_path / "precious").read_text() == "mine"
    assert not (tmp_path / "c.txt").is_symlink()


def test_two_writers_of_one_file_do_not_meet(tmp_path):
    """The first writer has not finished when the second, in the same process, writes the same file."""
    seen = []

    def first(temporary: Path) -> None:
        seen.append(temporary)
        temporary.write_text("first")
        write_whole(tmp_path / "x.json", second)
        assert (tmp_path / "x.json").read_text() == "second"

    def second(temporary: Path) -> None:
        seen.append(temporary)
        temporary.write_text("second")

    write_whole(tmp_path / "x.json", first)
    assert (tmp_path / "x.json").read_text() == "first"
    assert seen[0] != seen[1]
    assert {(path.parent, path.suffix, path.name[0]) for path in seen} == {(tmp_path, ".json", ".")}
    assert names(tmp_path) == ["x.json"]


# ---- permissions


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_a_new_file_has_the_permissions_that_open_gives_and_an_old_one_keeps_its_own(tmp_path, umask):
    before = os.umask(umask)
    try:
        write_text(tmp_path / "new", "text")
        (tmp_path / "secret").touch()
        (tmp_path / "secret").chmod(0o600)
        write_text(tmp_path / "secret", "text")
    finally:
        os.umask(before)
    assert mode(tmp_path / "new") == 0o666 & ~umask
    assert mode(tmp_path / "secret") == 0o600


def test_a_read_only_file_is_refused(tmp_path):
    """The user may write to the folder, and is not root, for whom nothing is read-only."""
    code = """
import os
from pathlib import Path
from shape_obs.utils.files import write_text
if os.geteuid() == 0:
    os.setuid(65534)
write_text(Path("file"), "after")
"""
    tmp_path.chmod(0o777)
    (tmp_path / "file").write_text("before")
    (tmp_path / "file").chmod(0o444)
    result = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert "PermissionError: cannot write file: permission denied: the file is read-only" in result.stderr
    assert (tmp_path / "file").read_text() == "before"
    assert names(tmp_path) == ["file"]


# ---- what goes wrong


def test_what_cannot_be_written_is_named(tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name, error, message in (
        ("folder", IsADirectoryError, "expected a file, there is a folder"),
        ("none/x", FileNotFoundError, f"there is no folder {tmp_path / 'none'}"),
        ("pipe", OSError, "expected a file, there is a device or a pipe"),
    ):
        with pytest.raises(error, match=f"cannot write {tmp_path / name}: {message}"):
            write_text(tmp_path / name, "text")
    assert names(tmp_path) == ["folder", "pipe"]


@pytest.mark.parametrize("error", [OSError("the disk is full"), ValueError("no"), KeyboardInterrupt()])
def test_the_old_file_survives_every_error(tmp_path, error):
    (tmp_path / "file").write_text("before")

    def write(temporary: Path) -> None:
        temporary.write_text("half of ")
        raise error

    with pytest.raises(type(error)):
        write_whole(tmp_path / "file", write)
    assert (tmp_path / "file").read_text() == "before"
    assert names(tmp_path) == ["file"]


def test_the_file_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    """Otherwise a power cut could leave an empty file; the folder is synchronised after it."""
    done = []
    fsync, replace = os.fsync, Path.replace
    monkeypatch.setattr(
        os, "fsync", lambda number: (done.append(os.readlink(f"/proc/self/fd/{number}")), fsync(number))
    )
    monkeypatch.setattr(Path, "replace", lambda path, to: (done.append("renamed"), replace(path, to)))
    write_text(tmp_path / "file", "text")
    assert [Path(name).name.split(".")[:2] for name in done] == [["", "file"], ["renamed"], [tmp_path.name]]


# ---- names that a document gives


def test_paths_stay_inside(tmp_path):
    folder, other = tmp_path / "recording", tmp_path / "other"
    for path in (folder / "rgb", other):
        path.mkdir(parents=True)
    (folder / "out").symlink_to(other)
    (folder / "in").symlink_to("rgb")
    assert inside(folder, "rgb/0.png") == folder / "rgb" / "0.png"
    assert inside(folder, "in/0.png") == folder / "in" / "0.png"
    for name in (
        "../other/0.png", str(other / "0.png"), "rgb/../0.png", "out/0.png", "", ".", "rgb\\0.png", "C:0.png", "\0",
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"expected a path inside|outside of|null"):
            inside(folder, name)
