"""Run claims, keep their results in one file, and report them as tables."""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

from shape_obs.bench.report import in_words, machine
from shape_obs.spec import to_plain
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import write_text
from shape_obs.utils.threads import one_thread
from tests.benchmarks.claim import Claim, Effort
from tests.benchmarks.tables import Row, as_markdown

MODULES: Final = (
    "ropes", "hidden", "record", "several", "outlines", "sheets", "clouds", "sigma", "clicks", "calibration", "envs",
    "deployment", "policies", "servo", "speed", "sensitivity",
)  # fmt: skip
RESULTS: Final = Path(__file__).with_name("results.json")


def all_claims(modules: Iterable[str] = MODULES) -> dict[str, Claim]:
    """Return the claims of modules by name."""
    claims = [claim for name in modules for claim in import_module(f"tests.benchmarks.{name}").CLAIMS]
    return {claim.name: claim for claim in claims}


def select(claims: Mapping[str, Claim], names: Sequence[str]) -> list[Claim]:
    """Return the claims of some names or groups, all without a name.

    Raises:
        ValueError: A name is neither a claim nor a group.
    """
    chosen: list[str] = []
    for name in names or claims:
        found = [each for each in claims if each == name or each.startswith(f"{name}.")]
        if not found:
            groups = dict.fromkeys(each.partition(".")[0] for each in claims)
            raise ValueError(f"no claim or group {name!r}; the groups are {', '.join(groups)}.")
        chosen += found
    return [claims[each] for each in dict.fromkeys(chosen)]


def run(claim: Claim, effort: Effort) -> Row:
    """Measure a claim on one thread.

    Returns:
        ``rows``: the table; ``limits``: a row of ``Limit.check`` for each limit; ``missing``: modules that are needed
        and not installed, in which case nothing is measured; ``what``, ``share``, ``seed``, ``commit``, ``seconds``.
    """
    if claim.held_out and effort.by_commit:
        effort = effort._replace(seed=commit_seed())
    missing = [name for name in claim.needs if find_spec(name) is None]
    begin = time.perf_counter()
    rows: list[Row] = []
    if not missing:
        with one_thread():
            rows = claim.table(effort)
    limits = [limit.check(rows, effort.share) for limit in claim.limits] if rows else []
    found = {"rows": rows, "limits": limits, "seconds": round(time.perf_counter() - begin, 1), "missing": missing}
    commit = _git("describe", "--always", "--dirty") or "unknown"
    return Row(found, what=claim.what, share=effort.share, seed=effort.seed, commit=commit)


def commit_seed() -> int:
    """Return a seed that derives from the hash of the commit; 0 without one."""
    return int(_git("rev-parse", "HEAD")[:7] or "0", 16)


def _git(*command: str) -> str:
    """Return what git prints, or nothing where it does not work."""
    called = ["git", "-C", str(RESULTS.parent), *command]
    try:
        return subprocess.run(called, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def run_all(claims: Iterable[Claim], effort: Effort, jobs: int = 1) -> Iterator[tuple[str, Row]]:
    """Measure claims in several processes, those that measure times alone afterwards; yield results as they come."""
    claims = list(claims)
    together = [claim for claim in claims if not claim.alone] if jobs > 1 else []
    if together:
        with ProcessPoolExecutor(jobs, mp_context=get_context("forkserver")) as pool:
            futures = {pool.submit(_run_named, claim.name, effort): claim.name for claim in together}
            for future in as_completed(futures):
                yield futures[future], future.result()
    for claim in claims:
        if claim not in together:
            yield claim.name, run(claim, effort)


def _run_named(name: str, effort: Effort) -> Row:
    return run(all_claims()[name], effort)


def misses(outcome: Row) -> list[Row]:
    """Return the limits that an outcome does not keep and that are not known to be missed."""
    return [limit for limit in outcome.limits if limit.met != "yes" and not limit.reason]


def save(path: Path, name: str, outcome: Row) -> None:
    """Write the results of one claim into the file of all results; those of other claims stay."""
    results = read_json(path, "results") if path.exists() else {"claims": {}}
    results["machine"] = machine()
    results["claims"][name] = outcome
    write_text(path, json.dumps(to_plain(results), indent=1) + "\n")


def page(results: Mapping[str, Any], text: str = "") -> str:
    """Return a Markdown page with the newest results in its blocks; without a page, one of all results.

    A block begins with a line ``<!-- table: NAME -->`` and ends with ``<!-- end -->``; without a result it stays.
    """
    claims = results["claims"]
    if not text:
        blocks = (f"## {name}\n\n{claims[name]['what']}\n\n<!-- table: {name} -->\n<!-- end -->" for name in claims)
        text = "\n\n".join(["# Results", in_words(results["machine"]), *blocks]) + "\n"

    def block(match: re.Match[str]) -> str:
        found = claims.get(match["name"])
        return match[0] if found is None else f"{match['begin']}\n{tables(found)}\n\n<!-- end -->"

    return re.sub(r"(?s)(?P<begin><!-- table: (?P<name>\S+) -->\n).*?<!-- end -->", block, text)


def tables(found: Mapping[str, Any]) -> str:
    """Return what was found for a claim as Markdown: its table, its limits, and why some are missed."""
    if found["missing"]:
        return f"Left out: {', '.join(found['missing'])} is not installed."
    parts = [as_markdown(rows) for rows in (found["rows"], found["limits"]) if rows] or ["No scene was measured."]
    when = f"Share {found['share']:g}, seed {found['seed']}, {found['seconds']:.0f} s, commit {found['commit']}."
    return "\n\n".join([*parts, when])


def main(argv: Sequence[str]) -> int:
    """Run the claims that are named, or all, and return the exit code.

    Returns:
        1 if a limit is missed that is not known to be missed; 2 for a wrong name; otherwise 0.
    """
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks",
        description="Measure claims against limits.",
        epilog="record export, record track, record score and gates have options of their own: gates --help",
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="claims or groups of claims (default: all)")
    parser.add_argument("--share", type=float, default=1.0, help="share of the full number of scenes (default: 1)")
    parser.add_argument("--seed", type=int, help="random seed (default: 0; of the group record, the commit's hash)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes; times are measured afterwards")
    parser.add_argument("--renderer", choices=("auto", "gl", "rays"), default="auto", help="the simulator's renderer")
    parser.add_argument("--garments", type=Path, metavar="FILE", help="JSON file of annotated garment outlines")
    parser.add_argument("--list", action="store_true", help="list the claims and end")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    parser.add_argument("--out", type=Path, default=RESULTS, metavar="FILE", help="the file of all results")
    parser.add_argument("--page", type=Path, metavar="FILE", help="only put the results into a page")
    args = parser.parse_args(argv)
    if args.share <= 0:
        parser.error("--share must be above 0")
    if args.page:
        text = args.page.read_text("utf-8") if args.page.exists() else ""
        write_text(args.page, page(read_json(args.out, "results"), text))
        return 0
    try:
        claims = select(all_claims(), args.names)
    except ValueError as error:
        parser.error(str(error))
    if args.list:
        print("\n".join(f"{claim.name:26}{claim.what}" for claim in claims))
        return 0
    effort = Effort(args.share, args.seed or 0, args.renderer, args.garments, by_commit=args.seed is None)
    missed, printed = [], {}
    for name, outcome in run_all(claims, effort, args.jobs):
        save(args.out, name, outcome)
        missed += [f"{name}: {each.limit}: {each.measured}, required {each.required}" for each in misses(outcome)]
        printed[name] = to_plain(outcome)
        if not args.json:
            print(f"## {name}\n\n{outcome.what}\n\n{tables(outcome)}\n", flush=True)
    print(json.dumps(printed, indent=1) if args.json else "\n".join(["missed:", *missed] if missed else []))
    return int(bool(missed))
