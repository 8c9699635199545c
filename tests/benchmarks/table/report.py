"""Write the table as Markdown and as values for a program."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Final

from tests.benchmarks.table.frames import CONFIGURATIONS, OF, missing
from tests.benchmarks.table.methods import SAMPLED, Method
from tests.benchmarks.table.run import EXACT, Plan
from tests.benchmarks.table.summary import LABELS, MEASURES, PAPER, TRACED
from tests.benchmarks.tables import Row, as_markdown

_COLUMNS: Final = {"sc": "SC", "ch": "CH", "ms": "time [s]"}
_SHOWN: Final[dict[str, tuple[float, int]]] = {"sc": (1, 3), "ch": (1, 0), "ms": (1e-3, 4)}  # factor, digits
_HEADS: Final = {
    "centerline": "Centerline, N = 20: the simulated cable, every pixel of the mask",
    "contour": "Contour, N = 32: drawn cloths, the pixels of the outline",
    "surface": "Surface, N = 32 (4 × 8): drawn cloths, every pixel of the mask",
}


def markdown(
    plan: Plan, machine: Mapping[str, str], found: Sequence[Row], ranked: Sequence[Row], traces: Sequence[Row]
) -> str:
    """Return the results as one page."""
    blocks = [_preface(plan, found), _ran_on(machine), _overall(found), _rankings(ranked), _beaten(found)]
    blocks += [_configuration(name, found) for name in CONFIGURATIONS]
    blocks.append(_tracings(traces))
    return "\n\n".join(block for block in blocks if block) + "\n"


def as_values(
    plan: Plan, machine: Mapping[str, str], found: Sequence[Row], ranked: Sequence[Row], traces: Sequence[Row]
) -> dict[str, Any]:
    """Return the results as JSON-able values; None is unknown."""
    skipped = {tracing: missing(tracing) for tracing in OF if missing(tracing)}
    run = {"settings": plan.settings(), "machine": dict(machine), "paper": PAPER}
    return _plain({**run, "results": found, "rankings": ranked, "tracings": traces, "skipped": skipped})


def _preface(plan: Plan, found: Sequence[Row]) -> str:
    exact = (
        f" on {EXACT} evenly spaced frames of each configuration, on the others of {SAMPLED} pixels drawn at random, "
        "each against all pixels"
    )
    lines = [
        f"{plan.frames} frames of each configuration, seed {plan.seed}. SC, the silhouette: of all pixels"
        f"{exact if plan.frames > EXACT else ''}. CH, the Calinski-Harabasz score: of all pixels. After ±: "
        "half the 95 % interval of the mean, where an episode counts as one value.",
        f"Time, by the {plan.clock} clock. Clusterers: from the pixels to the centres, cold in every frame, without "
        "the sorting along our form. Ours: from the mask to the ordered points, tracked.",
    ]
    refused = {result.configuration: result.refused for result in found if result.refused}
    if refused:
        lines.append(f"Frames on which no shape was found, and which are left out: {refused}.")
    return "\n\n".join(lines)


def _overall(found: Sequence[Row]) -> str:
    rows = []
    for result in (result for result in found if result.configuration == "all"):
        row = {"": LABELS[result.method]}
        for measure, head in _COLUMNS.items():
            row[f"{head}: paper, here"] = f"{_of_paper(result.method, measure)}, {_shown(result, measure)}"
        row |= {"gap CV": _percent(result.cv), "order right": _percent(result.ordered)}
        rows.append(row)
    return "## All three configurations\n\n" + as_markdown(rows) if rows else ""


def _configuration(name: str, found: Sequence[Row]) -> str:
    of = [result for result in found if result.configuration == name]
    if not of:
        return ""
    rows, settled = [], []
    for result in of:
        has_order = result.method in ("som", "kohonen")
        row = {"": LABELS[result.method]} | {head: _shown(result, measure) for measure, head in _COLUMNS.items()}
        own = _percent(result.own_order) if has_order else "none"
        row |= {"gap CV": _percent(result.cv), "order right, own": f"{_percent(result.ordered)}, {own}"}
        rows.append(row)
        if not has_order:
            settled.append(f"{LABELS[result.method]} {100 * result.settled:.0f} %")
    blocks = [f"## {_HEADS[name]}, M = {of[0].pixels:.0f}", as_markdown(rows)]
    if settled:
        blocks.append(f"Settled: {', '.join(settled)}.")
    return "\n\n".join(blocks)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _ran_on(machine: Mapping[str, str]) -> str:
    rest = dict(machine)
    hardware = f"{rest.pop('processor', 'unknown')}, {rest.pop('cores', '?')} cores, {rest.pop('system', '?')}"
    return f"Machine: {hardware}; {', '.join(f'{name} {what}' for name, what in rest.items())}."


def _beaten(found: Sequence[Row]) -> str:
    """List the measures by which another method has a better mean than ours."""
    lines = []
    for name, measure in product(CONFIGURATIONS, MEASURES):
        of = {result.method: result for result in found if result.configuration == name}
        sign = -1 if measure == "ms" else 1
        best = max(of.values(), key=lambda result, m=measure, s=sign: s * result[m], default=None)
        if "som" in of and best and sign * (best[measure] - of["som"][measure]) > 0:
            theirs, own = _shown(best, measure), _shown(of["som"], measure)
            lines.append(f"- {name}, {MEASURES[measure]}: {LABELS[best.method]} {theirs}, ours {own}")
    return "Ours does not have the best mean in:\n\n" + "\n".join(lines) if lines else ""


def _rankings(ranked: Sequence[Row]) -> str:
    """Compare the order of the paper's methods by each measure with that of the paper, as a whole and pair by pair."""
    rows = []
    for ranking in ranked:
        paper, here = (" > ".join(LABELS[method] for method in order) for order in (ranking.paper, ranking.here))
        open_ones = 6 - ranking.pairs - ranking.against
        rows.append({
            "by": MEASURES[ranking.measure],
            "holds": "yes" if ranking.holds else "**no**",
            "in the paper, best first": paper,
            "here, best first": here,
            "pairs": f"{ranking.pairs}, {ranking.against}, {open_ones}",
        })  # fmt: skip
    title = "The paper's ranking. Of the six pairs of methods: as in the paper, reversed, undecided."
    return f"{title}\n\n{as_markdown(rows)}" if rows else ""


def _tracings(traces: Sequence[Row]) -> str:
    rows = [
        {
            "": f"{TRACED[trace.tracing]} ({OF[trace.tracing]})",
            "points: least, median, most": ", ".join(map(str, trace.points)),
            "number changes": f"{100 * trace.changed:.0f} %",
            "first point wanders: median, most": ", ".join(_percent(x) for x in trace.moved),
            "order right": f"{100 * trace.ordered:.0f} %",
            "time [s]": f"{trace.ms * 1e-3:.4f}",
        }
        for trace in traces
    ]
    ends = [
        f"{TRACED[trace.tracing].capitalize()} has up to {trace.tips} ends."
        for trace in traces
        if OF[trace.tracing] == "centerline"
    ]
    skipped = [f"{TRACED[tracing]}: skipped, {missing(tracing)}." for tracing in OF if missing(tracing)]
    if not rows and not skipped:
        return ""
    blocks = ["## Tracing has no fixed sampling", *([as_markdown(rows)] if rows else []), *ends, *skipped]
    return "\n\n".join(blocks)


def _of_paper(method: Method, measure: str) -> str:
    factor, _ = _SHOWN[measure]
    value = PAPER.get(method, {}).get(measure)
    return "–" if value is None else f"{value * factor:g}"


def _shown(result: Row, measure: str) -> str:
    factor, digits = _SHOWN[measure]
    half = result[f"{measure}_half_interval"] * factor
    return f"{result[measure] * factor:.{digits}f}" + ("" if math.isnan(half) else f" ± {half:.{digits}f}")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value
