"""Rows of results, the columns of their summaries, and tables of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from shape_obs.bench.report import markdown_table


class Row(dict[str, Any]):
    """A row of a table, or one result of a measurement; its fields are also attributes."""

    def __getattr__(self, name: str) -> Any:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None


Column = Callable[[list[Row]], Any]


def summary(rows: Iterable[Row], by: Sequence[str], columns: Mapping[str, Column]) -> list[Row]:
    """Return a row for each group of rows, in the order in which the groups first appear.

    Args:
        rows: The rows.
        by: The fields that are equal in a group; they come first.
        columns: Name of a field of the summary -> function that takes the rows of a group.
    """
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in by), []).append(row)
    return [
        Row(zip(by, key, strict=True), **{name: column(some) for name, column in columns.items()})
        for key, some in groups.items()
    ]


def of(statistic: Callable[[list[Any]], Any], field: str, where: Callable[[Row], bool] = lambda row: True) -> Column:
    """Return the column of a summary that is a statistic of a field, over the rows that meet a condition.

    Args:
        statistic: Takes the values.
        field: Name of the field, or of an attribute of a field, such as ``"score.slip"``.
        where: The condition.
    """
    value = attrgetter(field)
    return lambda rows: statistic([value(row) for row in rows if where(row)])


def failures(*fields: str) -> Column:
    """Return the column of a summary that counts the rows in which one of the fields is not true."""
    return lambda rows: sum(not all(row[field] for field in fields) for row in rows)


def total(field: str) -> Column:
    """Return the column of a summary that is the sum of a field."""
    return lambda rows: sum(row[field] for row in rows)


def percent(part: str, whole: str = "") -> Column:
    """Return the column of a summary that is one sum in percent of another one, or of the number of rows."""
    return lambda rows: 100 * sum(row[part] for row in rows) / max(sum(row[whole] if whole else 1 for row in rows), 1)


def joined(statistic: Callable[[list[Any]], Any], field: str) -> Column:
    """Return the column of a summary that is a statistic of all values of a field of lists; None without a value."""

    def column(rows: list[Row]) -> Any:
        values = [value for row in rows for value in row[field]]
        return statistic(values) if values else None

    return column


def mean(values: Iterable[float]) -> float | None:
    """Return the mean of the numbers that are not NaN, or None if there are none."""
    known = [value for value in values if value == value]
    return float(np.mean(known)) if known else None


def worst(values: Iterable[float]) -> float | None:
    """Return the largest of the numbers that are not NaN, or None if there are none."""
    return max((float(value) for value in values if value == value), default=None)


def median(values: Iterable[float | None]) -> float | None:
    """Return the median of the numbers that are known and finite, or None if there are none."""
    known = [value for value in values if value is not None and np.isfinite(value)]
    return float(np.median(known)) if known else None


def as_markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows of equal keys as an aligned Markdown table with three significant digits."""

    def cell(value: Any) -> str:
        if isinstance(value, float):
            return f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"
        return "-" if value is None else str(value)

    return markdown_table([{name: cell(value) for name, value in row.items()} for row in rows])
