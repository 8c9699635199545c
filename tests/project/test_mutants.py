"""Every mutant in the list still applies; ``tests/support/mutants.py`` runs them."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import pytest
from constants import EXPLAINED, TRACKING, constant_mutants, constants, scaled, stages
from mutants import ROOT, mutated
from mutation import MUTANTS, Mutant

CONSTANTS = constant_mutants(10.0)


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_mutant_applies_and_loads(mutant: Mutant):
    text = (ROOT / mutant.file).read_text(encoding="utf-8")
    changed = mutated(text, mutant)
    assert changed != text
    ast.parse(changed)
    assert mutant.tests
    assert [test for test in mutant.tests if not (ROOT / test).is_file()] == []


def test_there_are_enough_of_every_part_and_names_are_unique():
    parts = Counter(mutant.name.split(":")[0] for mutant in MUTANTS)
    assert sum(parts.values()) >= 40
    assert set(parts) == {
        "validation",
        "lift",
        "tracking",
        "order",
        "curve",
        "missing",
        "rope",
        "sheet",
        "safety",
        "brought",
    }
    assert max(Counter(mutant.name for mutant in MUTANTS).values()) == 1


def test_a_replacement_that_is_gone_or_ambiguous_is_an_error():
    for text, count in (("", 0), ("ab ab", 2)):
        with pytest.raises(ValueError, match=f"'ab' occurs {count} times in some.py, expected once"):
            mutated(text, Mutant("it", "some.py", "ab", "c", ("t.py",)))
    assert Path(ROOT / "shape_obs").is_dir()


@pytest.mark.parametrize("path", sorted(TRACKING.glob("*.py")), ids=lambda path: path.stem)
def test_each_constant_of_the_tracking_is_replaced_by_another_value(path: Path):
    text = path.read_text(encoding="utf-8")
    values = {name: value for name, _, value in constants(text)}
    mutants = [mutant for pair in CONSTANTS for mutant in pair if (ROOT / mutant.file) == path]
    assert len(mutants) == 2 * len(values)
    for mutant in mutants:
        changed = {name: value for name, _, value in constants(mutated(text, mutant))}
        name = mutant.name.split(".")[1].split()[0]
        assert changed.pop(name) != values[name]
        assert changed == {other: value for other, value in values.items() if other != name}
        assert [test for test in mutant.tests if not (ROOT / test).is_file()] == []
        assert sorted(sum(stages(mutant.tests), ())) == sorted(mutant.tests)


def test_what_is_explained_is_a_constant():
    explained = {
        mutant.name.split()[0]: mutant.equivalent for pair in CONSTANTS for mutant in pair if mutant.equivalent
    }
    assert explained == EXPLAINED


def test_a_constant_is_a_number_or_a_tuple_of_numbers():
    numbers = "_A: Final = 8\n_B = (1 / 16, (math.cos(0), -2))\n"
    text = numbers + "_C = 'word'\n_D = 2 * _A\n_E = np.zeros(3)\n_F = True\n_G = ()"
    assert {name: value for name, _, value in constants(text)} == {"_A": 8, "_B": (1 / 16, (1.0, -2))}


@pytest.mark.parametrize(
    ("value", "times", "divided"),
    [
        (8, 80, 1),
        (1, 10, 0),
        (25, 250, 2),
        (0, 1, -1),
        (0.3, 3.0, 0.03),
        ((2, (0.5, 0.0)), (20, (5.0, 0.0)), (1, (0.05, 0.0))),
    ],
)
def test_an_integer_stays_an_integer_and_changes(value, times, divided):
    assert repr((scaled(value, 10.0), scaled(value, 0.1))) == repr((times, divided))
