"""Write the table as Markdown and as values for a program."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Final

from shape_obs.bench.table.frames import CONFIGURATIONS, OF, missing
from shape_obs.bench.table.methods import SAMPLED, Method
from shape_obs.bench.table.run import EXACT, Plan
from shape_obs.bench.table.summary import LABELS, MEASURES, PAPER, TRACED
from shape_obs.bench.tables import Row, as_markdown

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
    blocks = [_preface(plan, found), _ran_on(machine), _overall(found), *map(_verdict, ranked), _beaten(found)]
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
        f" on {EXACT} evenly spaced frames of each configuration, on the others of {SAMPLED} pixels drawn by lot, each "
        "against all pixels"
    )
    lines = [
        f"{plan.frames} frames of each configuration, seed {plan.seed}. SC, the silhouette: of all pixels"
        f"{exact if plan.frames > EXACT else ''}. CH, the Calinski-Harabasz score: always of all pixels. A pixel "
        "belongs to the nearest point. After ±: half the 95 % interval of the mean, an episode of frames counting as "
        "one.",
        f"Time, by the {plan.clock} clock: of a clusterer from the pixels to its centres, cold in every frame; of ours "
        "from the mask to the ordered points, tracked, as it is used. The clusterers' centres were sorted along our "
        "form, which is not timed.",
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
            row |= {f"{head}, paper": _of_paper(result.method, measure), head: _shown(result, measure)}
        rows.append({**row, **_quality(result)})
    return "## All three configurations\n\n" + as_markdown(rows) if rows else ""


def _configuration(name: str, found: Sequence[Row]) -> str:
    rows = []
    of = [result for result in found if result.configuration == name]
    for result in of:
        has_order = result.method in ("som", "kohonen")
        row = {"": LABELS[result.method]} | {head: _shown(result, measure) for measure, head in _COLUMNS.items()}
        row |= _quality(result)
        row["own order right"] = f"{100 * result.own_order:.1f} %" if has_order else "none"
        rows.append({**row, "settled": "" if has_order else f"{100 * result.settled:.0f} %"})
    return f"## {_HEADS[name]}, M = {of[0].pixels:.0f}\n\n" + as_markdown(rows) if rows else ""


def _quality(result: Row) -> dict[str, str]:
    return {"gap CV": f"{100 * result.cv:.1f} %", "order right": f"{100 * result.ordered:.1f} %"}


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


def _verdict(ranking: Row) -> str:
    paper, here = (" > ".join(LABELS[method] for method in order) for order in (ranking.paper, ranking.here))
    word = "holds" if ranking.holds else "does not hold"
    open_ones = 6 - ranking.pairs - ranking.against
    return (
        f"By {MEASURES[ranking.measure]} the paper's ranking {word}, best first: {paper} there, {here} here. Of the "
        f"six pairs {ranking.pairs} come out as in the paper, {ranking.against} the other way round, {open_ones} are "
        "undecided."
    )


def _tracings(traces: Sequence[Row]) -> str:
    rows = [
        {
            "": TRACED[trace.tracing],
            "of": OF[trace.tracing],
            "points: least / median / most": " / ".join(map(str, trace.points)),
            "another number than the frame before": f"{100 * trace.changed:.0f} %",
            "first point wanders over the material: median, most": ", ".join(f"{100 * x:.1f} %" for x in trace.moved),
            "order right": f"{100 * trace.ordered:.0f} %",
            "ends, most": str(trace.tips) if OF[trace.tracing] == "centerline" else "",
            "time [s]": f"{trace.ms * 1e-3:.4f}",
        }
        for trace in traces
    ]
    skipped = [f"{TRACED[tracing]}: skipped, {missing(tracing)}." for tracing in OF if missing(tracing)]
    if not rows and not skipped:
        return ""
    return "\n\n".join(["## Tracing has no fixed sampling", *([as_markdown(rows)] if rows else []), *skipped])


def _of_paper(method: Method, measure: str) -> str:
    factor, _ = _SHOWN[measure]
    value = PAPER.get(method, {}).get(measure)
    return "" if value is None else f"{value * factor:g}"


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
