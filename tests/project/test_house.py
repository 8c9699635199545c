"""The layout of the repository: number and order of packages and files, and mirrored tests."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE, ENVS, TESTS = ROOT / "shape_obs", ROOT / "envs" / "shape_obs_envs", ROOT / "tests"
MOST_ROOMS, MOST_FILES, MOST_LINES, MOST_SIBLINGS = 35, 436, 300, 5
# Folders of tests that test no single room.
WITHOUT_A_ROOM = {"project", "support"}
CONCEPTS = ROOT / "docs" / "concepts"
PAGES = [CONCEPTS / name for name in ("code.md", "a-frame-in-the-code.md", "add-a-stage.md")]


def python_files(*folders: Path) -> list[Path]:
    return [path for folder in folders for path in sorted(folder.rglob("*.py"))]


def folders_in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_dir() and list(path.glob("*.py")))


def rooms(package: Path) -> set[str]:
    """Return the packages and modules at the top of a package, without its ``__init__``."""
    modules = {path.stem for path in package.glob("*.py")} - {"__init__"}
    return modules | {path.parent.name for path in package.glob("*/__init__.py")}


def layers(container: str) -> list[list[str]]:
    """Return the layers of import-linter's contract for a package, lowest first."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contract = re.search(rf'containers = \["{container}"\]\n.*?layers = \[\n(.*?)\n\]', text, flags=re.S)
    assert contract is not None
    found = [line.strip().strip('",') for line in contract[1].splitlines()]
    return [list(reversed(line.split(" | "))) for line in reversed(found)]


def test_there_are_few_rooms():
    assert len(rooms(PACKAGE)) <= MOST_ROOMS


def test_there_are_few_files():
    assert len(python_files(PACKAGE, ENVS)) <= MOST_FILES


def test_no_file_is_long():
    lengths = {
        path.relative_to(ROOT).as_posix(): len(path.read_text(encoding="utf-8").splitlines())
        for path in python_files(PACKAGE, ENVS, TESTS, ROOT / "docs", ROOT / "examples")
    }
    assert {name: lines for name, lines in lengths.items() if lines > MOST_LINES} == {}


@pytest.mark.parametrize("package", [PACKAGE, ENVS], ids=lambda path: path.name)
def test_each_room_has_its_place_in_the_order_of_imports(package):
    order = [room for layer in layers(package.name) for room in layer]
    assert len(order) == len(set(order))
    assert set(order) == rooms(package)
    assert max(len(layer) for layer in layers(package.name)) <= MOST_SIBLINGS


def test_the_page_lists_the_rooms_in_the_order_of_imports():
    page = (CONCEPTS / "code.md").read_text(encoding="utf-8")
    table = page.split("## Packages and modules", 1)[1].split("\n## ", 1)[0]
    listed = re.findall(r"^\| `(\w+)", table, flags=re.M)
    assert listed == [room for layer in layers("shape_obs") for room in layer]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_page_names_files_that_exist(page):
    text = page.read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:shape_obs|envs|tests|docs)/[\w/.-]+|[\w/]+\.py)`", text))
    assert named
    for name in named:
        assert (ROOT / name).exists() or (PACKAGE / name).exists(), name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_page_names_functions_that_exist(page):
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"`(\w+)` in `([\w/]+\.py)`", text)
    assert named
    for function, file in named:
        source = (PACKAGE / file).read_text(encoding="utf-8")
        assert re.search(rf"^ *(def|class) {function}\b", source, flags=re.M), f"{function} in {file}"


def test_folders_of_tests_mirror_the_packages():
    for folder in folders_in(TESTS):
        place = folder.relative_to(TESTS)
        if place.parts[0] not in WITHOUT_A_ROOM:
            assert (PACKAGE / place).is_dir() or (ROOT / "envs" / place).is_dir(), place.as_posix()


def test_each_room_that_is_a_package_has_tests():
    for room in sorted(rooms(PACKAGE)):
        if (PACKAGE / room).is_dir():
            assert list((TESTS / room).rglob("test_*.py")), room
