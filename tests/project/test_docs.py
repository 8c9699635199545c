"""Every code block of README and docs runs, or says in a comment why it does not; links lead somewhere.

A ``python`` block is executed, the output of a ``pycon`` block is compared with the text, a ``yaml`` block is written
to ``shape.yaml``, and the ``shape-obs`` commands of a ``console`` block are run in a folder with a photo, a config file
and recordings. ``<!-- not run: REASON -->`` on the line before a block leaves it out. The
recipes in ``py`` blocks are compiled, and run where they need no library.
"""

from __future__ import annotations

import ast
import doctest
import importlib
import pkgutil
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from glob import glob
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest

from shape_obs import Centerline, HSVRange, Segmentation, ShapeDetector, save_config
from shape_obs.cli import COMMANDS as CLI_COMMANDS
from shape_obs.cli import main
from shape_obs.cli.bench import MEASUREMENTS
from shape_obs.cli.calibrate import CALIBRATIONS

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
REASON = r"(<!-- not run: ([^\n]+) -->\n)?"
BLOCK = re.compile(rf"^{REASON}```(python|pycon|yaml|console)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
BLUE = HSVRange((100, 120, 40), (125, 255, 255))


class Block(NamedTuple):
    language: str
    code: str
    line: int
    reason: str  # why it is not run, "" if it is


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def blocks(page: Path) -> list[Block]:
    text = read(page)
    return [
        Block(found[3], found[4], text[: found.start(4)].count("\n"), found[2] or "") for found in BLOCK.finditer(text)
    ]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT)).removeprefix("docs/")


def commands(code: str) -> list[str]:
    """Return the command lines of a console block, without prompts and outputs."""
    lines = code.replace("\\\n", " ").splitlines()
    return [line[2:] for line in lines if line.startswith("$ ")] or [line for line in lines if line and line[0] != "#"]


WITH_CODE = [page for page in PAGES if any(not block.reason for block in blocks(page))]
# The slowest pages, with robots and trained policies.
AT_NIGHT = {
    "how-to/deploy-a-policy.md", "how-to/export-to-lerobot.md", "how-to/record-a-robot.md", "how-to/save-a-policy.md",
    "how-to/test-without-a-robot.md", "reference/cli/demo.md",
}  # fmt: skip
COMMANDS = [
    (page, command)
    for page in PAGES
    for block in blocks(page)
    if block.language == "console"
    for command in commands(block.code)
]


def photo(shift: int = 0) -> np.ndarray:
    """Return a blue rope on gray that lies so many pixels lower, as OpenCV writes it."""
    s = np.linspace(0, 1, 400)
    rope = np.stack([120 + 400 * s, 240 + shift + 60 * np.sin(6 * s)], axis=1)
    image = np.full((480, 640, 3), (190, 198, 200), np.uint8)
    cv2.polylines(image, [np.round(rope).astype(np.int32)], False, (160, 70, 20), 17, cv2.LINE_AA)
    return image


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    """Make what the pages call rope.png, shape.yaml, cable and recordings."""
    folder = tmp_path_factory.mktemp("samples")
    cv2.imwrite(str(folder / "rope.png"), photo())
    save_config(folder / "shape.yaml", {"shapes": [Centerline(n=20)], "segmentation": BLUE})
    for seed, recording in enumerate(("cable", "recordings/monday", "recordings/tuesday")):
        (folder / recording).parent.mkdir(exist_ok=True)
        settings = f"--frames 20 --set actions=random seed={seed}"
        run(f"shape-obs record --source ShapeObs/Cable-v0 {settings} -o {folder / recording}")
    return folder


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.nightly) if name(page) in AT_NIGHT else page for page in WITH_CODE],
    ids=name,
)
def test_samples_run(page, tmp_path, monkeypatch, request):
    text = read(page)
    wanted = [block for block in blocks(page) if not block.reason]
    if "ShapeObs/" in text or any(block.language == "console" for block in wanted):
        pytest.importorskip("mujoco")
    if any(block.language == "console" for block in wanted):
        shutil.copytree(request.getfixturevalue("samples"), tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    if "--pick" in text:  # which writes it
        Path("shape.yaml").unlink(missing_ok=True)
    import shape_obs.image.clicked_colours
    import shape_obs.image.mask_function  # noqa: F401  # kinds that a page may import while members are patched

    monkeypatch.setattr(Segmentation, "_members", dict(Segmentation._members))  # samples define kinds
    # What a sample defines must be found by name, as dataclasses and pickle do.
    names: dict[str, object] = {"__name__": "builtins"}
    for language, code, line, _ in wanted:
        if language == "yaml":
            Path("shape.yaml").write_text(code, encoding="utf-8")
        elif language == "python":
            exec(compile("\n" * line + code, str(page), "exec"), names)
        elif language == "console":
            for command in commands(code):
                run(command)
        else:
            sample = doctest.DocTestParser().get_doctest(code, names, page.name, str(page), line)
            report: list[str] = []
            runner = doctest.DocTestRunner(optionflags=FLAGS, verbose=False)
            runner.run(sample, out=report.append, clear_globs=False)
            names.update(sample.globs)
            assert not report, "".join(report)


def run(command: str) -> None:
    """Run a command line as a shell does."""
    program, *arguments = shlex.split(command, comments=True)
    assert program == "shape-obs", f"{command}: only shape-obs is run; say why with <!-- not run: REASON -->"
    expanded = [path for argument in arguments for path in (sorted(glob(argument)) or [argument])]
    try:
        code = main(expanded)
    except SystemExit as end:
        code = end.code
    assert code in (0, None), f"{command}: exit code {code}"


def test_the_commands_of_the_pages_have_only_options_that_exist(capsys):
    known: dict[str, set[str]] = {}
    wrong = []
    for page, command in COMMANDS:
        for part in re.findall(r"shape-obs ((?:bench |calibrate )?[a-z][a-z-]*)([^|;&]*)", command):
            words, rest = part[0], part[1]
            if words not in known:
                with pytest.raises(SystemExit):
                    main([*words.split(), "--help"])
                known[words] = set(re.findall(r"--[a-z][a-z0-9-]*", capsys.readouterr().out))
            wrong += [
                f"{name(page)}: {words} {o}"
                for o in re.findall(r"(?<!\S)--[a-z][a-z0-9-]*", rest)
                if o not in known[words]
            ]
    assert not wrong


def test_links_within_the_repository_lead_somewhere():
    others = [ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", ROOT / ".github" / "ISSUE_TEMPLATE" / "bug_report.yml"]
    targets = [(page, target) for page in (*PAGES, *others) for target in LINK.findall(read(page))]
    wrong = [
        f"{name(page)}: {to}"
        for page, to in targets
        if not (page.parent / to.replace("../blob/main/", "../../")).exists()
    ]
    assert wrong == []


def linked(page: Path) -> set[Path]:
    """Return the pages that a page links to, in its text or its tables of contents."""
    text = read(page)
    targets = {target for target in LINK.findall(text) if target.endswith(".md")}
    for toctree in re.findall(r"^```{toctree}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        targets |= {f"{line}.md" for line in toctree.split() if not line.startswith(":")}
    return {path for target in targets if (path := (page.parent / target).resolve()).exists()}


def test_every_page_is_at_most_three_clicks_from_the_index():
    reached = {(ROOT / "docs" / "index.md").resolve()}
    for _ in range(3):
        reached |= {page for known in reached for page in linked(known)}
    assert {page.resolve() for page in PAGES[1:]} <= reached


def test_the_readme_has_the_two_commands_as_they_are_promised():
    lines = read(ROOT / "README.md").splitlines()
    assert "pip install uv && uv run --no-dev --extra sim shape-obs demo" in lines
    assert "uv run pytest" in lines


PARTS = {"calibrate": CALIBRATIONS, "bench": MEASUREMENTS}
COMMAND_LINES = [command for command in CLI_COMMANDS if command not in PARTS]
COMMAND_LINES += [f"{group} {part}" for group, parts in PARTS.items() for part in parts]
CLI_PAGES = ROOT / "docs" / "reference" / "cli"


@pytest.mark.parametrize("command", COMMAND_LINES)
def test_the_page_of_a_command_documents_every_option(command, capsys):
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    known = set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out))
    page = read(CLI_PAGES / f"{command.replace(' ', '-')}.md")
    documented = set(re.findall(r"--[a-z][a-z-]*", page))
    pairs = {f"--no-{name[2:]}" for name in known}  # the form that switches off an option that is on
    assert known - pairs - {"--help"} == documented - pairs


def test_the_table_of_commands_lists_every_page():
    page = read(CLI_PAGES / "index.md")
    listed = re.findall(r"^\| \[`([a-z -]+)`\]\(([a-z-]+)\.md\)", page, flags=re.MULTILINE)
    assert sorted(command for command, _ in listed) == sorted(COMMAND_LINES)
    assert all(command.replace(" ", "-") == name for command, name in listed)


API = ROOT / "docs" / "reference" / "api"
ENTRY = re.compile(r"^\.\. auto(?:class|function|exception|data|module):: (\S+)", re.MULTILINE)


def resolve(path: str) -> Any:
    module, _, name = path.rpartition(".")
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError:
        return getattr(resolve(module), name)


def packages() -> Iterator[Any]:
    for root in map(importlib.import_module, ("shape_obs", "shape_obs_envs")):
        yield root
        for module in pkgutil.walk_packages(root.__path__, f"{root.__name__}."):
            if module.ispkg and not module.name.startswith("shape_obs.tuner"):
                yield importlib.import_module(module.name)


def test_every_public_name_is_listed_once():
    for name in ("mujoco", "torch", "pyarrow"):
        pytest.importorskip(name)
    entries = [entry for page in sorted(API.glob("*.md")) for entry in ENTRY.findall(read(page))]
    assert len(entries) == len(set(entries))
    listed = [resolve(entry) for entry in entries]
    for package in packages():
        for name in getattr(package, "__all__", ()):
            public = getattr(package, name)
            assert any(public is entry for entry in listed), f"{package.__name__}.{name} is on no page of the API"


def test_the_scripts_find_what_they_import():
    for script in sorted((ROOT / "docs" / "pictures").glob("*.py")):
        for statement in ast.walk(ast.parse(read(script))):
            if isinstance(statement, ast.ImportFrom) and str(statement.module).startswith(("shape_obs", "tests")):
                module = importlib.import_module(str(statement.module))
                for alias in statement.names:
                    assert hasattr(module, alias.name), f"{script.name}: {statement.module} has no {alias.name}"


def unnumbered(text: str) -> str:
    """Hide the digits: the last ones differ between versions of NumPy and OpenCV."""
    return re.sub(r"\d+(\.\d+)?", "#", text)


def test_the_page_on_failures_has_the_reasons_and_qualities_that_come_out(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "pictures"))
    from failures import CASES  # pyright: ignore[reportMissingImports]

    page = read(ROOT / "docs" / "concepts" / "what-can-go-wrong.md")
    silent = page.split("## Silent failures")[1]
    for name, make in CASES.items():
        shape = make().shape
        (row,) = [line for line in page.splitlines() if f"images/wrong_{name}.jpg" in line]
        assert (ROOT / "docs" / "images" / f"wrong_{name}.jpg").exists()
        assert shape.reason or not shape.valid.all(), name
        assert f"wrong_{name}.jpg" not in silent
        if shape.reason:
            assert f'"{unnumbered(shape.reason)}"' in unnumbered(row)
        else:
            (quality,) = re.findall(r"0\.\d\d", row)
            assert shape.quality == pytest.approx(float(quality), abs=0.02)


NETWORKS = ROOT / "docs" / "how-to" / "segment-with-a-network.md"
RECIPES = dict(re.findall(r"^```py\n# (\w+)\.py\n(.*?)^```$", read(NETWORKS), flags=re.M | re.S))


def test_the_recipes_for_networks_compile_and_a_box_prompt_follows_the_object(tmp_path, monkeypatch):
    assert set(RECIPES) == {"onnx_masks", "box_masks", "sam_masks", "yolo_masks", "supervision_shapes"}
    for recipe, code in RECIPES.items():
        compile(code, recipe, "exec")
    (tmp_path / "box_masks.py").write_text(RECIPES["box_masks"], encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    detector, by_colour = (ShapeDetector([Centerline(n=20)], rule) for rule in ("box_masks:rope", BLUE))
    for shift in (0, 10, 20, 30):
        picture = photo(shift)[..., ::-1].copy()
        shape, expected = (each.detect(picture).shapes[0] for each in (detector, by_colour))
        assert shape.ok, shape.reason
        assert np.linalg.norm(shape.pixels - expected.pixels, axis=1).max() < 3
    from box_masks import rope  # pyright: ignore[reportMissingImports]

    assert rope.box != rope.first
    assert not detector.detect(np.full((480, 640, 3), 200, np.uint8)).shapes[0].visible.any()
    assert rope.box == rope.first
    sys.modules.pop("box_masks")
