"""Faults in what is known of a cloth or an outline, and in how what is hidden of it is put back."""

from __future__ import annotations

from .mutant import Mutant

_BORDER = "tests/tracking/test_hidden_border.py"
_OUTLINE = "tests/tracking/test_hidden_outline.py"
_TURNS = "tests/tracking/test_registration.py"
_VIEW = "tests/tracking/test_sheet_view.py"
_LATTICE = "tests/geometry/test_lattice.py"
_SPACED = "tests/configurations/test_contour_in_space.py"


def _sheet(name: str, module: str, old: str, new: str, *tests: str, equivalent: str = "") -> Mutant:
    return Mutant(f"sheet: {name}", f"shape_obs/{module}.py", old, new, tests or (_BORDER,), equivalent)


SHEETS: tuple[Mutant, ...] = (
    _sheet("nothing lies over", "tracking/hidden_border", "            return metres < z", "            return False"),
    _sheet(
        "the first frame of an outline has no depth",
        "tracking/hidden_border",
        "-(-len(rim) // every)",
        "len(rim) // every",
    ),
    _sheet("the place outweighs the form", "tracking/hidden_outline", "_PLACE: Final = 0.005", "_PLACE: Final = 0.05"),
    _sheet("a dent without turns hides", "tracking/hidden_outline", "_TURN: Final = 0.28", "_TURN: Final = -9.0",
           _OUTLINE),
    _sheet("gaps may differ", "tracking/validation", "_MAX_UNEQUAL: Final = 0.03", "_MAX_UNEQUAL: Final = 0.3"),
    _sheet("gaps differ by noise", "tracking/validation", "_OF_NOISE: Final = 0.8", "_OF_NOISE: Final = 0.08"),
    _sheet("a crumpled sheet is gone", "tracker", "and found.reason:", "and True:"),
    _sheet("turns are not seen", "tracking/hidden_outline", "_TURN: Final = 0.28", "_TURN: Final = 1.4", _OUTLINE),
    _sheet("a dent is not seen", "tracking/hidden_outline", "Final = (1.2, 0.01)", "Final = (12.0, 0.1)", _OUTLINE),
    _sheet("what lies far off counts", "tracking/hidden_outline", "_STRAY: Final = 2.0", "_STRAY: Final = 200.0",
           _OUTLINE),
    _sheet("all that bends counts", "tracking/registration_in_space", "_BENT: Final = 2.0", "_BENT: Final = 2e3"),
    _sheet("what touches hides", "tracking/hidden_outline", "bool((far > _WITHIN[0])", "bool((far > -1.0)", _OUTLINE),
    _sheet("noise turns a circle", "tracking/registration_in_space", "_FLAT: Final = (3e-4, 1.0)",
           "_FLAT: Final = (3e-4, 0.0)", _TURNS),
    _sheet("the noise of a turning goes on", "tracking/registration_in_space", "_ROUND: Final = 0.06",
           "_ROUND: Final = 0.0", _TURNS),
    _sheet("sides are forgotten fast", "tracking/sheet_view", "Final = (0.0022, 0.001)", "Final = (0.022, 0.01)"),
    _sheet("sides may be of any length", "tracking/corner_matching", "((0.04, 0.07), 2.0)", "((0.4, 0.7), 20.0)"),
    _sheet("the table is not seen", "tracking/sheet_view", "_THROUGH: Final = 0.02", "_THROUGH: Final = 2.0"),
    _sheet(
        "depth has no slope at a border",
        "point_cloud/local_depth",
        "if not sloped or known < _ENOUGH:",
        "if True:",
        "tests/point_cloud/test_median_depth.py",
    ),
    _sheet("a plane reaches over a hole", "tracking/hidden_border", "_MIN_KNOWN: Final = 0.5",
           "_MIN_KNOWN: Final = 0.2"),
    _sheet("what lies off its form is not doubted", "tracking/sheet_view", "_DOUBTED: Final = (0.3, 1.0)",
           "_DOUBTED: Final = (3.0, 10.0)", _VIEW),
    _sheet("what bends is doubted", "tracking/sheet_view", "_LOCAL: Final = 2.5", "_LOCAL: Final = 0.5", _VIEW),
    _sheet("a dent is learnt", "tracking/sheet_view", "(limit / far[p]) ** 4 if", "1.0 if", _VIEW),
    _sheet("uneven gaps are visible", "geometry/lattice", "_UNEVEN: Final = 0.09", "_UNEVEN: Final = 0.9", _LATTICE),
    _sheet("noise is uneven", "geometry/lattice", "_OFTEN: Final = 3.0", "_OFTEN: Final = 0.3", _LATTICE),
    _sheet("any outline may be hidden", "tracking/hidden_outline", "_ALMOST: Final = 0.4", "_ALMOST: Final = -9.0",
           _OUTLINE, equivalent="The closer look finds nothing either: it only takes longer."),
    _sheet("an outline is spread over the image", "configurations/contour", "or form.space is None else form.space",
           "or True else form.space", _SPACED),
    _sheet("lost values stay their neighbours'", "geometry/topology", "_SWEEPS: Final = 60", "_SWEEPS: Final = 0",
           _LATTICE),
)  # fmt: skip
