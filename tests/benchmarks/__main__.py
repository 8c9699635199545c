"""Run the claims of this project: ``uv run python -m tests.benchmarks [NAME ...]``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from shape_obs.utils.documents import read_json
from tests.benchmarks.claim import Effort
from tests.benchmarks.runner import RESULTS, all_claims, misses, plain, report, run_all, save, select, write_page
from tests.benchmarks.tables import as_text


def main(argv: Sequence[str]) -> int:
    """Run the claims that are named, or all, and return the exit code.

    Returns:
        1 if a limit is missed that is not known to be missed; 2 for a wrong name; otherwise 0.
    """
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="claims or groups of claims (default: all)")
    parser.add_argument("--share", type=float, default=1.0, help="share of the full number of scenes (default: 1)")
    parser.add_argument("--seed", type=int, default=0, help="random seed (default: 0)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes; times are measured afterwards")
    parser.add_argument("--renderer", choices=("auto", "gl", "rays"), default="auto", help="the simulator's renderer")
    parser.add_argument("--garments", type=Path, metavar="FILE", help="JSON file of annotated garment outlines")
    parser.add_argument("--list", action="store_true", help="list the claims and end")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    parser.add_argument("--out", type=Path, default=RESULTS, metavar="FILE", help="the file of all results")
    parser.add_argument("--page", type=Path, action="append", default=[], metavar="FILE",
                        help="measure nothing, and fill the tables of this Markdown page from the results")  # fmt: skip
    args = parser.parse_args(argv)
    if args.share <= 0:
        parser.error("--share must be above 0")
    if args.page:
        for page in args.page:
            print(f"{page}: {', '.join(write_page(page, read_json(args.out, 'results'))) or 'no table'}")
        return 0
    try:
        claims = select(all_claims(), args.names)
    except ValueError as error:
        parser.error(str(error))
    if args.list:
        print("\n".join(f"{claim.name:24}{claim.what}" for claim in claims))
        return 0
    effort, missed, printed = Effort(args.share, args.seed, args.renderer, args.garments), [], {}
    for claim, outcome in run_all(claims, effort, args.jobs):
        save(args.out, claim, outcome, effort)
        missed += [f"{claim.name}: {limit.limit}: asked {limit.asked}, seen {limit.seen}" for limit in misses(outcome)]
        printed[claim.name] = plain(outcome)
        if not args.json:
            print(report(claim, outcome, as_text), flush=True)
    print(json.dumps(printed, indent=1) if args.json else "\n".join(["", "missed:", *missed] if missed else []))
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
