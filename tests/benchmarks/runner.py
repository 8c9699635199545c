"""Run claims, keep their results in one file, and fill the tables of documentation pages from it."""

from __future__ import annotations

import json
import math
import re
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib import import_module
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

from shape_obs.utils.documents import read_json
from shape_obs.utils.files import write_text
from shape_obs.utils.threads import one_thread
from tests.benchmarks.claim import Claim, Effort
from tests.benchmarks.tables import Row, as_markdown
from tests.benchmarks.timing import machine

MODULES: Final = (
    "ropes", "hidden", "several", "outlines", "sheets", "clouds", "sigma", "clicks", "calibration", "envs",
    "deployment", "servo", "speed",
)  # fmt: skip
RESULTS: Final = Path(__file__).with_name("results.json")
_MARKED: Final = re.compile(r"(<!-- table: (?P<name>\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def all_claims() -> dict[str, Claim]:
    """Return every claim by name."""
    claims = [claim for name in MODULES for claim in import_module(f"tests.benchmarks.{name}").CLAIMS]
    return {claim.name: claim for claim in claims}


def select(claims: Mapping[str, Claim], names: Sequence[str]) -> list[Claim]:
    """Return the claims of some names or groups, all without a name.

    Raises:
        ValueError: A name is neither a claim nor a group.
    """
    chosen: dict[str, Claim] = {}
    for name in names or claims:
        found = {each: claims[each] for each in claims if each == name or each.startswith(f"{name}.")}
        if not found:
            groups = dict.fromkeys(each.partition(".")[0] for each in claims)
            raise ValueError(f"no claim or group {name!r}; the groups are {', '.join(groups)}.")
        chosen |= found
    return list(chosen.values())


def run(claim: Claim, effort: Effort) -> Row:
    """Measure a claim on one thread.

    Returns:
        ``rows``: the table; ``limits``: a row of ``Limit.check`` for each limit; ``seconds``; ``missing``: modules that
        the claim needs and that are not installed, in which case nothing is measured.
    """
    missing = [name for name in claim.needs if find_spec(name) is None]
    begin = time.perf_counter()
    rows: list[Row] = []
    if not missing:
        with one_thread():
            rows = claim.table(claim.results(effort))
    limits = [limit.check(rows, effort.share) for limit in claim.limits] if rows else []
    return Row(rows=rows, limits=limits, seconds=round(time.perf_counter() - begin, 1), missing=missing)


def run_all(claims: Iterable[Claim], effort: Effort, jobs: int = 1) -> Iterator[tuple[Claim, Row]]:
    """Measure claims in several processes, those that measure times alone afterwards; yield results as they come."""
    claims = list(claims)
    together = [claim for claim in claims if not claim.alone] if jobs > 1 else []
    if together:
        with ProcessPoolExecutor(jobs, mp_context=get_context("forkserver")) as pool:
            futures = {pool.submit(_run_named, claim.name, effort): claim for claim in together}
            for future in as_completed(futures):
                yield futures[future], future.result()
    for claim in claims:
        if claim not in together:
            yield claim, run(claim, effort)


def _run_named(name: str, effort: Effort) -> Row:
    return run(all_claims()[name], effort)


def misses(outcome: Row, *, known: bool = False) -> list[Row]:
    """Return the limits that an outcome does not keep: the unexpected misses, or the known ones."""
    return [limit for limit in outcome.limits if limit.ok != "yes" and bool(limit.known) == known]


def save(path: Path, claim: Claim, outcome: Row, effort: Effort) -> None:
    """Write the results of one claim into the file of all results; those of other claims stay."""
    results = read_json(path, "results") if path.exists() else {"claims": {}}
    results["machine"] = machine("mujoco", "gymnasium")
    results["claims"][claim.name] = {
        "what": claim.what,
        "share": effort.share,
        "seed": effort.seed,
        "commit": _commit(),
        **outcome,
    }
    write_text(path, json.dumps(plain(results), indent=1) + "\n")


def plain(value: Any) -> Any:
    """Return a value as JSON has it: numbers of NumPy become Python's, and what is not finite None."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(each) for each in value]
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _commit() -> str:
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    return found.stdout.strip() or "unknown"


def write_page(page: Path, results: Mapping[str, Any]) -> list[str]:
    """Fill the tables between ``<!-- table: NAME -->`` and ``<!-- end -->`` of a page, and return their names.

    A page that does not exist is made, with the tables of all results. A table without results stays as it is.
    """
    filled: list[str] = []

    def table(match: re.Match[str]) -> str:
        found = results["claims"].get(match["name"])
        if found is None or not found["rows"]:
            return match[0]
        filled.append(match["name"])
        return f"{match[1]}\n{_markdown(found)}\n\n{match[3]}"

    if page.exists():
        text = page.read_text(encoding="utf-8")
    else:
        about = ", ".join(f"{name} {value}" for name, value in results["machine"].items())
        parts = [f"## {name}\n\n{found['what']}\n\n<!-- table: {name} -->\n<!-- end -->\n"
                 for name, found in results["claims"].items()]  # fmt: skip
        text = "\n".join([f"# Results\n\n{about}\n", *parts])
    write_text(page, _MARKED.sub(table, text))
    return filled


def _markdown(found: Mapping[str, Any]) -> str:
    """Return a claim's table and its limits, as Markdown."""
    parts = [as_markdown(found["rows"])]
    if found["limits"]:
        limits = [
            {"Limit": each["limit"], "Asked": each["asked"], "Seen": each["seen"], "Kept": each["ok"]}
            for each in found["limits"]
        ]
        parts.append(as_markdown(limits))
    parts.append(f"Share {found['share']:g} of the full counts, seed {found['seed']}, commit {found['commit']}.")
    return "\n\n".join(parts)


def report(claim: Claim, outcome: Row, text: Callable[[Sequence[Mapping[str, Any]]], str]) -> str:
    """Return a claim's table and limits as text."""
    head = f"\n{claim.name}: {claim.what} ({outcome.seconds:.0f} s)"
    if outcome.missing:
        return f"{head}\nleft out: {', '.join(outcome.missing)} is not installed"
    if not outcome.rows:
        return f"{head}\nno scene was measured"
    shown = [Row((name, limit[name]) for name in ("limit", "asked", "seen", "ok")) for limit in outcome.limits]
    parts = [head, text(outcome.rows), *([text(shown)] if shown else [])]
    parts += [
        f"known{'' if limit.ok != 'yes' else ', but met now'}: {limit.limit}: {limit.known}"
        for limit in outcome.limits
        if limit.known
    ]
    return "\n".join(parts)
