"""Run the claims of this project: ``uv run python -m tests.benchmarks [NAME ...]``."""

from __future__ import annotations

import sys

from tests.benchmarks.runner import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
