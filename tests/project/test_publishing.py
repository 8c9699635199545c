"""The files for publishing agree with pyproject.toml: citation, badges, templates, hooks and the Dockerfile."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from importlib import metadata, util
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*_*.yml"))
#: What the schema of CFF 1.2.0 requires of the file, and of each reference.
NEEDED = {"cff-version", "message", "title", "authors"}
NEEDED_OF_A_REFERENCE = {"type", "title", "authors"}
LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def pyproject() -> dict[str, Any]:
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 reads no TOML")
    return tomllib.loads(read("pyproject.toml"))


def test_the_citation_is_valid_and_of_this_version(pyproject):
    citation = yaml.safe_load(read("CITATION.cff"))
    assert citation.keys() >= NEEDED
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] == "software"
    assert citation["version"] == pyproject["project"]["version"]
    assert citation["license"] == pyproject["project"]["license"]
    assert citation["authors"] == pyproject["project"]["authors"]
    for reference in citation["references"]:
        assert reference.keys() >= NEEDED_OF_A_REFERENCE


def test_the_citation_names_the_paper_of_the_readme():
    (paper,) = yaml.safe_load(read("CITATION.cff"))["references"]
    assert paper["title"] in " ".join(read("README.md").split())


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.name)
def test_the_forms_of_issues_have_the_keys_of_the_schema(path):
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert {"name", "description", "body"} <= form.keys() <= {"name", "description", "title", "labels", "body"}
    for part in form["body"]:
        assert part["type"] in {"markdown", "textarea", "input", "dropdown", "checkboxes"}
        assert ("value" if part["type"] == "markdown" else "label") in part["attributes"]
    names = [part["id"] for part in form["body"] if part["type"] != "markdown"]
    assert len(names) == len(set(names)) > 0


def test_there_are_forms_for_bugs_and_features():
    assert [path.name for path in FORMS] == ["bug_report.yml", "feature_request.yml"]
    assert yaml.safe_load(read(".github/ISSUE_TEMPLATE/config.yml")) == {"blank_issues_enabled": True}


def test_the_form_of_bugs_asks_for_what_a_report_needs():
    text = read(".github/ISSUE_TEMPLATE/bug_report.yml")
    assert "shape-obs replay RECORDING --config shape.yaml" in text
    for target in re.findall(r"\(\.\./blob/main/([^)]+)\)", text):
        assert (ROOT / target).exists(), target
    (command,) = re.findall(r"`python (-c \"[^`]*)`", text)
    done = subprocess.run([sys.executable, *shlex.split(command)], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert metadata.version("shape-obs") in done.stdout


def test_the_security_policy_leads_somewhere():
    text = read("SECURITY.md")
    for target in LINK.findall(text):
        assert (ROOT / target).exists(), target
    for heading in ("Supported versions", "Report a vulnerability"):
        assert f"## {heading}" in text
    assert len(text.split()) <= 500


def test_the_badges_match_the_project(pyproject):
    spec = util.spec_from_file_location("badges", ROOT / "docs" / "pictures" / "badges.py")
    assert spec is not None
    assert spec.loader is not None
    script = util.module_from_spec(spec)
    spec.loader.exec_module(script)
    folder = ROOT / "docs" / "images" / "badges"
    drawn = {path.stem: path.read_text(encoding="utf-8") for path in folder.glob("*.svg")}
    assert drawn == script.badges(), "run `uv run python docs/pictures/badges.py`"
    assert len(drawn) <= 4
    assert all(len(svg.encode()) < 2048 for svg in drawn.values())
    assert pyproject["project"]["version"] in drawn["version"]
    wrong = {**pyproject["project"], "requires-python": ">=3.9"}
    with pytest.raises(ValueError, match="disagree"):
        script.facts(wrong)
    wrong = {**pyproject["project"], "dependencies": ["torch>=2"]}
    with pytest.raises(ValueError, match="CPU"):
        script.facts(wrong)


def test_the_image_installs_extras_and_a_python_that_exist(pyproject):
    lines = read("Dockerfile").splitlines()
    project = pyproject["project"]
    (extras,) = (line.removeprefix("ARG EXTRAS=") for line in lines if line.startswith("ARG EXTRAS="))
    assert set(extras.split(",")) <= set(project["optional-dependencies"])
    (python,) = (line.removeprefix("FROM python:").removesuffix("-slim") for line in lines if line.startswith("FROM"))
    assert f"Programming Language :: Python :: {python}" in project["classifiers"]
    assert any(line.startswith("USER ") and line != "USER root" for line in lines)


def test_the_image_gets_all_files_that_the_build_needs(pyproject):
    copied = {
        word for line in read("Dockerfile").splitlines() if line.startswith("COPY ") for word in line.split()[1:-1]
    }
    tool = pyproject["tool"]["hatch"]["build"]["targets"]
    needed = {"pyproject.toml", pyproject["project"]["readme"], *pyproject["project"]["license-files"]}
    assert needed <= copied
    for package in tool["wheel"]["packages"]:
        assert package.split("/")[0] in copied
    admitted = {line[1:] for line in read(".dockerignore").splitlines() if line.startswith("!")}
    assert admitted == copied
    assert all((ROOT / name).exists() for name in copied)


def test_the_hooks_run_tools_of_the_dev_group(pyproject):
    named = {re.split(r"[\s\[<>=;!~]", line)[0] for line in pyproject["dependency-groups"]["dev"]}
    (repository,) = yaml.safe_load(read(".pre-commit-config.yaml"))["repos"]
    assert repository["repo"] == "local"
    commands = set()
    for hook in repository["hooks"]:
        assert hook["language"] == "system"
        assert hook["entry"].startswith("uv run --no-sync ")
        commands.add(hook["entry"].split()[3])
    assert commands >= {"ruff", "pyright"}
    owners = {entry.name: entry.dist for entry in metadata.entry_points(group="console_scripts")}
    for command in commands:
        owner = owners.get(command)  # None for Ruff, which is a program of its package's name
        assert (owner.name.replace("_", "-") if owner is not None else command) in named, command
    assert "pre-commit" in named


def test_the_source_distribution_holds_what_these_tests_read(pyproject):
    included = set(pyproject["tool"]["hatch"]["build"]["targets"]["sdist"]["include"])
    for name in ("CITATION.cff", "SECURITY.md", "CONTRIBUTING.md", "Dockerfile", ".pre-commit-config.yaml", ".github"):
        assert f"/{name}" in included, name
    assert all((ROOT / name[1:]).exists() for name in included)
