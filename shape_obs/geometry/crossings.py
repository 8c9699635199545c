"""Places where strands lie over each other: their Gauss codes, and how often which shape is above."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Counts = npt.NDArray[np.int64]


class Crossing(NamedTuple):
    """A place where two strands lie over each other in the image.

    Args:
        slots: The names of both shapes; equal where a shape crosses itself.
        arcs: Where on each shape, as shares 0...1 of its length from its point 0. Of a shape with itself the smaller
            share is first.
        pixel: (u, v).
        above: Which strand is nearer to the camera: 0 for the first, 1 for the second, None if unknown.
        handedness: The sign of ``du0 * dv1 - dv0 * du1`` for the directions (du, dv) of the first and the second
            strand in pixels, each towards larger shares: +1 if the second runs across the first from its left to its
            right as seen in the image, where v points down, -1 if from right to left.
    """

    slots: tuple[str, str]
    arcs: tuple[float, float]
    pixel: tuple[float, float]
    above: int | None
    handedness: int

    @property
    def sign(self) -> int:
        """The sign of the crossing as knot theory defines it, +1 if right-handed, -1 if left-handed, 0 if unknown.

        A crossing is right-handed if the upper strand must be turned counter-clockwise as seen, by less than a half
        turn, to point as the lower one does. The sign of a crossing of a shape with itself does not depend on which
        end is point 0.
        """
        return 0 if self.above is None else self.handedness * (1 if self.above else -1)


class Visit(NamedTuple):
    """One passage of a strand through a crossing: a letter of a Gauss code.

    Args:
        number: Of the crossing, from 1 on, in the order of the first passages.
        over: Whether the strand is above there; None if unknown.
        sign: ``Crossing.sign``.
    """

    number: int
    over: bool | None
    sign: int

    def __str__(self) -> str:
        level = "?" if self.over is None else "O" if self.over else "U"
        return f"{level}{self.number}{'-?+'[self.sign + 1]}"


def gauss_code(crossings: Sequence[Crossing], name: str) -> tuple[Visit, ...]:
    """Return the signed Gauss code of one shape: its crossings with itself, in order from its point 0.

    References:
        C. F. Gauss, Werke VIII, 1900, pp. 271-286. M. Goussarov, M. Polyak and O. Viro, "Finite-type Invariants of
        Classical and Virtual Knots", 2000: the code with signs determines the drawing up to moves on the sphere.
    """
    return gauss_codes([crossing for crossing in crossings if crossing.slots == (name, name)], [name])[name]


def gauss_codes(crossings: Sequence[Crossing], names: Sequence[str]) -> dict[str, tuple[Visit, ...]]:
    """Return the code of several shapes: all crossings among them, in order along each from its point 0.

    Each crossing has one number in all codes. Crossings with shapes that are not in ``names`` are left out.
    """
    strands = passages(crossings, names)
    number: dict[int, int] = {}
    codes = {}
    for name, strand in zip(names, strands, strict=True):
        code = []
        for at in strand:
            crossing, above = crossings[at // 2], crossings[at // 2].above
            over = None if above is None else above == at % 2
            code.append(Visit(number.setdefault(at // 2, len(number) + 1), over, crossing.sign))
        codes[name] = tuple(code)
    return codes


def format_code(code: Sequence[Visit]) -> str:
    """Return a code as text: ``"O1- U2- O3- U1- O2- U3-"`` for a trefoil; O is over, U under, ? unknown."""
    return " ".join(map(str, code))


def passages(crossings: Sequence[Crossing], names: Sequence[str]) -> list[list[int]]:
    """Return the passages along each of some shapes, in order from its point 0.

    Passage ``2 * c`` is that of the first strand through ``crossings[c]``, ``2 * c + 1`` that of the second.
    """
    rows: dict[str, list[tuple[float, int]]] = {name: [] for name in names}
    for c, (slots, arcs, *_) in enumerate(crossings):
        if slots[0] in rows and slots[1] in rows:
            for side in (0, 1):
                rows[slots[side]].append((arcs[side], 2 * c + side))
    return [[at for _, at in sorted(rows[name])] for name in names]


def crossing_matrix(crossings: Sequence[Crossing], names: Sequence[str]) -> tuple[Counts, Counts]:
    """Return how often each shape lies above each other one, and how often that is unknown.

    Returns:
        ``(K, K)`` above: entry [i, j] counts the crossings where shape i is known to lie above shape j; [i, i] those
        of the shape with itself of which it is known which strand is above.
        ``(K, K)`` unknown: entries [i, j] and [j, i] count the other crossings of the two, [i, i] those of the shape
        with itself. So ``above + above.T + unknown`` counts all crossings of two different shapes.
    """
    index = {name: k for k, name in enumerate(names)}
    above, unknown = np.zeros((2, len(index), len(index)), np.int64)
    for crossing in crossings:
        pair = [index.get(slot, -1) for slot in crossing.slots]
        if min(pair, default=-1) < 0:
            continue
        if crossing.above is not None:
            above[pair[crossing.above], pair[1 - crossing.above]] += 1
        else:
            unknown[pair[0], pair[1]] += 1
            if pair[0] != pair[1]:
                unknown[pair[1], pair[0]] += 1
    return above, unknown
