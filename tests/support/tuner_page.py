"""``shape-obs tune`` in a process of its own, and a real headless Chromium to open its page with."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

COMMAND = "from shape_obs.cli import main; main()"
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


def chromium(playwright: Any) -> str | None:
    """Return the path of a Chromium: one on the PATH, or Playwright's own; None if there is none."""
    for name in NAMES:
        if path := shutil.which(name):
            return path
    own = playwright.chromium.executable_path
    return own if Path(own).exists() else None


class Served:
    """A running ``shape-obs tune``.

    Args:
        process: The process.
        line: What it printed first.
    """

    def __init__(self, process: subprocess.Popen[str], line: str) -> None:
        self.process = process
        found = re.search(r"http://\S+", line)
        assert found is not None, line
        self.url = found[0]

    @property
    def port(self) -> int:
        found = re.search(r":(\d+)/", self.url)
        assert found is not None
        return int(found[1])


@contextmanager
def serving(*arguments: Any, script: Path | None = None) -> Iterator[Served]:
    """Run ``shape-obs tune`` on any free port, or a script that takes the same place, and end it."""
    command = [sys.executable, *(("-c", COMMAND, "tune") if script is None else (str(script),))]
    options = ["--port", "0", "--no-open"] if script is None else []
    process = subprocess.Popen(
        [*command, *map(str, arguments), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell's job in the background ignores SIGINT, and so would the process.
        preexec_fn=(lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)) if os.name == "posix" else None,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        line = process.stdout.readline()
        if not line:
            process.wait(20)
            raise AssertionError(process.stderr.read())
        yield Served(process, line)
    finally:
        process.terminate()
        try:
            process.wait(20)
        finally:
            process.kill()
            process.stdout.close()
            process.stderr.close()
