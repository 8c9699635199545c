"""Every mutant in the list still applies; ``tests/support/mutants.py`` runs them."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import pytest
from mutants import ROOT, mutated
from mutation import MUTANTS, Mutant


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
    assert set(parts) == {"validation", "lift", "tracking", "order", "curve", "missing", "rope", "sheet", "safety"}
    assert max(Counter(mutant.name for mutant in MUTANTS).values()) == 1


def test_a_replacement_that_is_gone_or_ambiguous_is_an_error():
    for text, count in (("", 0), ("ab ab", 2)):
        with pytest.raises(ValueError, match=f"'ab' occurs {count} times in some.py, expected once"):
            mutated(text, Mutant("it", "some.py", "ab", "c", ("t.py",)))
    assert Path(ROOT / "shape_obs").is_dir()
