"""Run the claims of this project: ``uv run python -m tests.benchmarks [NAME ...]``.

``record export``, ``record track`` and ``record score`` read and write files, see ``record_files``; ``gates`` compares
with another work tree, see ``gates``.
"""

from __future__ import annotations

import sys

from tests.benchmarks import gates, record_files, runner

if __name__ == "__main__":
    argv = sys.argv[1:]
    in_files = argv[:1] == ["record"] and argv[1:2] and argv[1] in record_files.COMMANDS
    if argv[:1] == ["gates"]:
        sys.exit(gates.main(argv[1:]))
    sys.exit(record_files.main(argv[1:]) if in_files else runner.main(argv))
