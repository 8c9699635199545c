"""Describe a claim as data: its scenes, how one scene is measured, how rows are summarised, and the limits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from tests.benchmarks.tables import Column, Row, summary


class Effort(NamedTuple):
    """State how much to measure.

    Args:
        share: Share of the full counts; 1 is the full run.
        seed: Seed of everything that is drawn at random.
        renderer: The simulator's renderer: ``"auto"``, ``"gl"`` or ``"rays"``.
        garments: A JSON file of annotated garment outlines; None leaves them out.
        by_commit: Whether the seed of claims that are held out is that of the commit instead.
    """

    share: float = 1.0
    seed: int = 0
    renderer: str = "auto"
    garments: Path | None = None
    by_commit: bool = False

    def count(self, full: int) -> int:
        """Return the share of a full count, at least one."""
        return max(round(full * self.share), 1)

    def seeds(self, full: int) -> range:
        """Return the share of a full number of seeds."""
        return range(self.seed, self.seed + self.count(full))


@dataclass(frozen=True)
class Limit:
    """Bound a column of a claim's table.

    Args:
        column: The column.
        at_most: The largest value that is allowed; None for no upper bound.
        at_least: The smallest value that is allowed; None for no lower bound.
        unit: Unit of the value, for the report.
        where: Field -> value, or tuple of values, of the rows to which the limit applies; all rows if it is empty.
        sampled: The bound at a reduced share, at which one scene weighs more; None for the same bound.
        known: Why the limit is missed today; such a miss does not fail the run.
    """

    column: str
    at_most: float | None = None
    at_least: float | None = None
    unit: str = ""
    where: Mapping[str, Any] = field(default_factory=dict)
    sampled: float | None = None
    known: str = ""

    def check(self, table: Sequence[Row], share: float = 1.0) -> Row:
        """Compare the worst row of a table, measured at some share, with the limit.

        Returns:
            ``limit``: column and rows; ``required``, ``measured``; ``met``: "yes", "no" or "not measured"; ``reason``.
        """
        wanted = {name: value if isinstance(value, tuple) else (value,) for name, value in self.where.items()}
        rows = [row for row in table if all(row[name] in values for name, values in wanted.items())]
        values = [float(value) for row in rows if (value := row[self.column]) is not None and value == value]
        below, bound = self.at_most is not None, self.at_least if self.at_most is None else self.at_most
        if share < 1 and self.sampled is not None:
            bound = self.sampled
        assert bound is not None
        seen = (max if below else min)(values, default=None)
        keeps = seen is not None and (seen <= bound if below else seen >= bound)
        return Row(
            limit=", ".join([self.column, *(f"{name} {' or '.join(map(str, some))}" for name, some in wanted.items())]),
            required=f"{'<=' if below else '>='} {bound:g}{self.unit and ' ' + self.unit}",
            measured=seen,
            met="not measured" if seen is None else "yes" if keeps else "no",
            reason=self.known,
        )


@dataclass(frozen=True)
class Claim:
    """State one claim about accuracy or speed, which ends in one table.

    Args:
        name: Its name, such as ``"ropes.cold"``; the part before the dot is its group.
        what: What is measured, in one sentence.
        scenes: Takes the effort and generates the scenes, in an order that a seed fixes.
        measure: Takes a scene and returns one row of results, or several.
        by: The fields that are equal in a row of the table.
        columns: Name of a column -> function that takes the rows of a group. Without any, all rows are the table.
        total: Whether the table ends with a row over all groups, whose first field is "all".
        limits: What the table has to keep.
        alone: Whether nothing else may run at the same time, because times are compared with constants.
        needs: Modules without which the claim is left out.
        held_out: Whether its scenes differ from commit to commit unless a seed is given, so that no one tunes on them.
    """

    name: str
    what: str
    scenes: Callable[[Effort], Iterable[Any]]
    measure: Callable[[Any], Row | Iterable[Row]]
    by: tuple[str, ...] = ()
    columns: Mapping[str, Column] = field(default_factory=dict)
    total: bool = False
    limits: tuple[Limit, ...] = ()
    alone: bool = False
    needs: tuple[str, ...] = ()
    held_out: bool = False

    def table(self, effort: Effort) -> list[Row]:
        """Measure every scene and return the table."""
        results: list[Row] = []
        for scene in self.scenes(effort):
            found = self.measure(scene)
            results += [found] if isinstance(found, Row) else found
        if not self.columns:
            return results
        rows = summary(results, self.by, self.columns)
        if self.total and rows:
            whole = summary(results, (), self.columns)[0]
            rows.append(Row({name: "all" if name == self.by[0] else "" for name in self.by}, **whole))
        return rows
