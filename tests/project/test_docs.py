"""The code samples of README and docs run, and print what they say."""

from __future__ import annotations

import doctest
import re
from pathlib import Path

import pytest

from shape_obs import Segmentation

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(python|pycon|yaml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NOT_RUN = re.compile(r"^<!-- not run: [^\n]+ -->\n\Z", re.MULTILINE)
LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE

WITH_CODE = [page for page in PAGES if BLOCK.search(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("page", WITH_CODE, ids=lambda page: page.name)
def test_samples_run(page, tmp_path, monkeypatch):
    if "ShapeObs/" in page.read_text(encoding="utf-8"):
        pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Segmentation, "_members", dict(Segmentation._members))  # samples define kinds
    text = page.read_text(encoding="utf-8")
    # What a sample defines must be found by name, as dataclasses and pickle do.
    names: dict[str, object] = {"__name__": "builtins"}
    for block in BLOCK.finditer(text):
        language, code = block.groups()
        if NOT_RUN.search(text[: block.start()]):
            continue
        line = text[: block.start()].count("\n") + 1
        if language == "yaml":
            Path("shape.yaml").write_text(code, encoding="utf-8")
        elif language == "python":
            exec(compile("\n" * line + code, str(page), "exec"), names)
        else:
            sample = doctest.DocTestParser().get_doctest(code, names, page.name, str(page), line)
            report: list[str] = []
            runner = doctest.DocTestRunner(optionflags=FLAGS, verbose=False)
            runner.run(sample, out=report.append, clear_globs=False)
            names.update(sample.globs)
            assert not report, "".join(report)


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.name)
def test_links_within_the_repository_lead_somewhere(page):
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_readme_has_the_two_commands_as_they_are_promised():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert "pip install uv && uv run --no-dev --extra sim shape-obs demo" in lines
    assert "uv run pytest" in lines


@pytest.mark.parametrize(
    "command",
    ["demo", "detect", "record", "replay", "bench claims", "bench table", "bench peers", "bench latency", "bench envs"]
    + [
        "markers",
        "calibrate intrinsics",
        "calibrate base",
        "goal",
        "deploy",
        "fit-features",
        "extract",
        "bench servo",
        "ablate",
    ],
)
def test_the_page_of_the_command_line_documents_every_option(command, capsys):
    from shape_obs.cli import main

    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    known = set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out))
    page = (ROOT / "docs" / "reference" / "cli" / f"{command.replace(' ', '-')}.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"--[a-z][a-z-]*", page))
    assert {name for name in known if not name.startswith("--no-")} - {"--help"} == documented
