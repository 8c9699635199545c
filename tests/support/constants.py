"""The numeric constants of the tracking as mutants: each ten times as large, and a tenth as large.

A constant is weakened in the direction in which it does less. Which one that is cannot be read from the code, so a
constant counts as tested if tests notice at least one of the two: fast tests run in both directions, then slow ones,
until one fails.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mutation import Mutant

TRACKING = Path(__file__).resolve().parents[2] / "shape_obs" / "tracking"

# Files that take more than half a minute, each run on its own after the others.
_SLOW = (
    "tests/tracking/test_occlusion.py",
    "tests/bench/test_motion_claims.py",
    "tests/bench/test_rope_claims.py",
)
_ROPES = (
    "tests/tracking/test_rope_match.py",
    "tests/tracking/test_rope_length.py",
    "tests/tracking/test_occluders.py",
    "tests/tracking/test_predicted_rope.py",
    "tests/tracking/test_ropes_in_space.py",
    "tests/configurations/test_centerline.py",
    *_SLOW[:2],
)
_OUTLINES = (
    "tests/configurations/test_contour_ring.py",
    "tests/configurations/test_contour.py",
    "tests/configurations/test_contour_in_space.py",
    "tests/tracking/test_hidden_border.py",
    "tests/tracking/test_hidden_outline.py",
)
_SHEETS = (
    "tests/tracking/test_corner_matching.py",
    "tests/tracking/test_sheet_view.py",
    "tests/configurations/test_surface_map.py",
    "tests/configurations/test_surface.py",
    "tests/tracking/test_hidden_border.py",
)
_EVERY_SHAPE = (
    "tests/tracking/test_ropes_in_space.py",
    "tests/configurations/test_contour.py",
    "tests/configurations/test_surface.py",
    "tests/test_degenerate_input.py",
)
_SEVERAL = (
    "tests/slots/test_slots.py",
    "tests/tracking/test_scene_doubt.py",
    "tests/bench/test_several_rope_claims.py",
    "tests/cli/test_detect_several.py",
)
# The test files that a constant of a file concerns, after the file's own tests; those that are fast come first.
_TESTS: dict[str, tuple[str, ...]] = {
    "belief": (*_EVERY_SHAPE, "tests/bench/test_belief_claims.py"),
    "corner_matching": _SHEETS,
    "exchanges": _SEVERAL,
    "hidden_border": (*_SHEETS, *_OUTLINES),
    "hidden_outline": _OUTLINES,
    "missing": ("tests/test_degenerate_input.py",),
    "occluders": _ROPES,
    "occlusion": _ROPES,
    "placement": _ROPES,
    "predicted_rope": _ROPES,
    "prediction": ("tests/tracking/test_search_window.py", *_EVERY_SHAPE, *_OUTLINES),
    "registration": (*_OUTLINES, "tests/bench/test_contour_claims.py"),
    "registration_in_space": (*_OUTLINES, "tests/bench/test_contour_claims.py"),
    "rope_length": _ROPES,
    "rope_match": _ROPES,
    "scene_doubt": _SEVERAL,
    "search_window": _EVERY_SHAPE,
    "seats": _SEVERAL,
    "sheet_view": _SHEETS,
    "validation": (*_EVERY_SHAPE, "tests/bench/test_worst_case_claims.py", _SLOW[2]),
}

# Constants that no test can notice, and why.
EXPLAINED: dict[str, str] = {
    "missing._LARGEST_STEP": "it keeps digits for later steps; ten times as much leaves enough",
    "missing._LEAST_STEP": "what two stamps that differ by no time may differ by",
    "occluders._SPARSE": "it only saves time: every second row and column show the same",
    "prediction._LEAST_INTERVAL": "what two stamps that differ by no time may differ by",
    "sheet_view._SOME": "it only saves time: the median of fewer points is nearly the same",
}


def constants(text: str) -> Iterator[tuple[str, str, Any]]:
    """Yield the numeric constants at the top of a module.

    Yields:
        Its name, its statement as it stands in the text, and its value: a number or a tuple of numbers.
        Arrays, and what is computed from other constants, are left out.
    """
    for node in ast.parse(text).body:
        target = node.target if isinstance(node, ast.AnnAssign) else None
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            target = node.targets[0]
        if not isinstance(node, (ast.Assign, ast.AnnAssign)) or not isinstance(target, ast.Name) or node.value is None:
            continue
        statement = ast.get_source_segment(text, node)
        value = _evaluated(node.value)
        if statement is not None and value is not None:
            yield target.id, statement, value


def _evaluated(expression: ast.expr) -> Any:
    """Return the value of an expression of nothing but numbers; None for anything else."""
    try:
        value = eval(compile(ast.Expression(expression), "", "eval"), {"math": math, "__builtins__": {}})
    except NameError:
        return None
    return value if _numeric(value) else None


def _numeric(value: Any) -> bool:
    if isinstance(value, tuple):
        return len(value) > 0 and all(map(_numeric, value))
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def scaled(value: Any, factor: float) -> Any:
    """Return a number or the numbers of a tuple times a factor; a positive integer becomes no 0 unless it is 1."""
    if isinstance(value, tuple):
        return tuple(scaled(part, factor) for part in value)
    if isinstance(value, float):
        return float(f"{value * factor:.12g}")
    changed = max(round(value * factor), min(value - 1, 1))
    return changed if changed != value else value + (1 if factor > 1 else -1)


def constant_mutants(factor: float) -> list[tuple[Mutant, Mutant]]:
    """Return a pair of mutants for each constant of the tracking: times the factor, and divided by it."""
    pairs: list[tuple[Mutant, Mutant]] = []
    for path in sorted(TRACKING.glob("*.py")):
        text = path.read_text(encoding="utf-8")
        for name, statement, value in constants(text):
            pairs.append(
                (_mutant(path, name, statement, value, factor), _mutant(path, name, statement, value, 1 / factor))
            )
    return pairs


def _mutant(path: Path, name: str, statement: str, value: Any, factor: float) -> Mutant:
    begin = statement[: statement.index("=") + 1]
    sign = "x" if factor > 1 else "/"
    file = path.relative_to(TRACKING.parents[1]).as_posix()
    # From the line's begin, as another name may end with this one.
    return Mutant(
        f"{path.stem}.{name} {sign}",
        file,
        f"\n{statement}",
        f"\n{begin} {scaled(value, factor)!r}",
        tests_of(path.stem),
        EXPLAINED.get(f"{path.stem}.{name}", ""),
    )


def tests_of(stem: str) -> tuple[str, ...]:
    """Return the test files of a file of the tracking, its own first, each once."""
    own = [f"tests/tracking/test_{stem}.py"] if _has_tests(stem) else []
    return tuple(dict.fromkeys([*own, *_TESTS[stem]]))


def _has_tests(stem: str) -> bool:
    return (TRACKING.parents[1] / "tests" / "tracking" / f"test_{stem}.py").is_file()


def stages(tests: Sequence[str]) -> list[tuple[str, ...]]:
    """Return test files in groups to run one after the other: the fast ones together, then each slow one."""
    return [tuple(test for test in tests if test not in _SLOW), *((test,) for test in tests if test in _SLOW)]


def named(pairs: Sequence[tuple[Mutant, Mutant]], words: Sequence[str]) -> list[tuple[Mutant, Mutant]]:
    """Return the pairs whose name contains one of the words; all without any word."""
    return [pair for pair in pairs if not words or any(word in pair[0].name for word in words)]
