"""The mutants, by what they break."""

from .mutant import Mutant as Mutant
from .safety import SAFETY
from .shapes import SHAPES
from .tracks import TRACKS

MUTANTS: tuple[Mutant, ...] = SHAPES + TRACKS + SAFETY
