"""Mutants, grouped by the contract that they break."""

from .mutant import Mutant as Mutant
from .ropes import ROPES
from .safety import SAFETY
from .shapes import SHAPES
from .tracks import TRACKS

MUTANTS: tuple[Mutant, ...] = SHAPES + TRACKS + ROPES + SAFETY
