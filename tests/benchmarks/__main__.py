"""Run the claims of this project: ``uv run python -m tests.benchmarks [NAME ...]``."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from shape_obs.spec import to_plain
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import write_text
from tests.benchmarks.claim import Effort
from tests.benchmarks.runner import RESULTS, all_claims, misses, page, report, run_all, save, select


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
    parser.add_argument("--page", type=Path, metavar="FILE", help="measure nothing, and write a page of all results")
    args = parser.parse_args(argv)
    if args.share <= 0:
        parser.error("--share must be above 0")
    if args.page:
        write_text(args.page, page(read_json(args.out, "results")))
        return 0
    try:
        claims = select(all_claims(), args.names)
    except ValueError as error:
        parser.error(str(error))
    if args.list:
        print("\n".join(f"{claim.name:26}{claim.what}" for claim in claims))
        return 0
    effort, missed, printed = Effort(args.share, args.seed, args.renderer, args.garments), [], {}
    for name, outcome in run_all(claims, effort, args.jobs):
        save(args.out, name, outcome)
        missed += [f"{name}: {limit.limit}: asked {limit.asked}, seen {limit.seen}" for limit in misses(outcome)]
        printed[name] = to_plain(outcome)
        if not args.json:
            print(report(name, outcome), end="\n\n", flush=True)
    print(json.dumps(printed, indent=1) if args.json else "\n".join(["missed:", *missed] if missed else []))
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
