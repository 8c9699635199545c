"""Mutants, grouped by the contract that they break."""

from .foreign import FOREIGN
from .mutant import Mutant as Mutant
from .ropes import ROPES
from .safety import SAFETY
from .shapes import SHAPES
from .sheets import SHEETS
from .tracks import TRACKS

MUTANTS: tuple[Mutant, ...] = SHAPES + TRACKS + ROPES + SHEETS + SAFETY + FOREIGN
