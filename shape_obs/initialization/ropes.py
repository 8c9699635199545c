"""Every rope of a mask: strands joined over gaps where that is unambiguous, and why each one may be wrong."""

from __future__ import annotations

from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.curve import FittedCurve
from shape_obs.image.region import Region
from shape_obs.initialization.appearance import Picture, are_unlike, look_of_end
from shape_obs.initialization.gaps import CLEAR, DEARER, NOISE, STIFFNESS, Lead, bending, bridge, lead
from shape_obs.initialization.medial_axis import even, find_strands
from shape_obs.initialization.objects import SHORTEST_ROPE, SceneObject
from shape_obs.initialization.pinholes import without_pinholes
from shape_obs.initialization.strand_curves import Strand
from shape_obs.initialization.strand_doubts import reach_beyond

Array = npt.NDArray[np.float64]
End = tuple[int, int]  # a strand, and which of its ends

_ACROSS: Final = 0.15  # rad^2 that a rope bends at most from another one on over a gap; real cables bend a little
_STUB: Final = 4.0  # widths: what is shorter and ends on another rope is a knob of that one, or noise


class Gap(NamedTuple):
    """How far apart two pieces of one rope are at most.

    Args:
        widths: From end to end; a curve ends up to a width before its rope.
        bend: What the way over it may bend, rad^2.
    """

    widths: float
    bend: float


NARROW: Final = Gap(3.0, CLEAR)  # what noise or another rope leaves out of a mask


def find_ropes(region: Region, picture: Picture | None = None, gap: Gap = NARROW) -> tuple[list[SceneObject], str]:
    """Return the ropes of a mask, longest first, and why there are none.

    Args:
        region: The mask of any number of ropes that may lie over each other.
        picture: ``(H, W, 3)`` RGB, in which ropes may have colours of their own; None without one.
        gap: What may lie between two pieces of one rope.
    """
    strands, refusal = find_strands(without_pinholes(region), picture, several=True)
    strands = [each for each in strands if each.length >= (_STUB if any(each.inside) else SHORTEST_ROPE) * each.width]
    ropes = [_rope(strand, region) for strand in _joined(strands, region, picture, gap)]
    if not ropes and not refusal:
        refusal = f"nothing in the mask is {SHORTEST_ROPE:.2g} times as long as it is wide"
    return sorted(ropes, key=lambda rope: -rope.curve.size), refusal


def _joined(strands: list[Strand], region: Region, picture: Picture | None, widest: Gap) -> list[Strand]:
    """Join strands end to end, cheapest first, where no other end is about as good a continuation.

    An end that lies on another rope goes on beyond that one, if a gap in the mask is what keeps the two apart.
    """
    ends = [(i, e) for i, strand in enumerate(strands) if not strand.closed for e in (0, 1)]
    away = {(i, e): strands[i].curve[:: 1 - 2 * e] for i, e in ends}
    leads = {(i, e): lead(curve, strands[i].width) for (i, e), curve in away.items()}
    across = {
        (i, e): reach_beyond(away[i, e], strands[i].width, region).border for i, e in ends if strands[i].inside[e]
    }
    price = {(a, b): _price(strands, a, b, leads, across, widest) for a, b in combinations(ends, 2) if a[0] != b[0]}
    near = {end for pair, cost in price.items() if cost < np.inf for end in pair}
    looks = {(i, e): look_of_end(away[i, e], strands[i].width, picture) for i, e in near}
    price = {(a, b): cost for (a, b), cost in price.items() if cost < np.inf and not are_unlike(looks[a], looks[b])}
    doubted: set[int] = set()
    chains = {i: [(i, 0)] for i in range(len(strands))}  # by the strand it begins with: which end each is entered by
    of = {i: i for i in chains}
    for (a, b), cost in sorted(price.items(), key=lambda item: item[1]):
        rivals = [other for pair, other in price.items() if pair != (a, b) and {a, b} & set(pair)]
        if min(rivals, default=np.inf) < DEARER * cost or of[a[0]] == of[b[0]]:
            continue
        first, second = chains.pop(of[a[0]]), chains.pop(of[b[0]])
        first = first if _last(first) == a else _turned(first)
        second = second if second[0] == b else _turned(second)
        chains[first[0][0]] = first + second
        if not {a, b} & across.keys() and bending(leads[a], leads[b]) > NOISE:
            doubted.add(a[0])
        of |= {i: first[0][0] for i, _ in first + second}
    return [
        _chained([strands[i] for i, _ in chain], _outer(strands, chain), bent=any(i in doubted for i, _ in chain))
        if len(chain) > 1
        else strands[chain[0][0]]
        for chain in chains.values()
    ]


def _price(
    strands: list[Strand], a: End, b: End, leads: dict[End, Lead], across: dict[End, float], widest: Gap
) -> float:
    """Return what it costs to join two ends, in widths of gap; inf for a gap that is too wide or too bent.

    Of a gap that begins on another rope, what lies on that one does not count; ``across`` is so many pixels.
    """
    if a in across and b in across:
        return np.inf
    width = max(strands[a[0]].width, strands[b[0]].width)
    ends = [strands[i].curve[-e] for i, e in (a, b)]
    most = _ACROSS if a in across or b in across else widest.bend
    gap = max(float(np.linalg.norm(ends[1] - ends[0])) - across.get(a, 0.0) - across.get(b, 0.0), 0.0) / width
    bend = bending(leads[a], leads[b]) if gap < widest.widths else np.inf
    return gap + STIFFNESS / 2 * bend if bend < most else np.inf


def _last(chain: list[End]) -> End:
    return chain[-1][0], 1 - chain[-1][1]


def _turned(chain: list[End]) -> list[End]:
    return [(i, 1 - e) for i, e in reversed(chain)]


def _outer(strands: list[Strand], chain: list[End]) -> tuple[bool, bool]:
    """Return whether the first and the last end of a chain lie on another strand."""
    (first, e), (last, f) = chain[0], _last(chain)
    return strands[first].inside[e], strands[last].inside[f]


def _chained(pieces: list[Strand], inside: tuple[bool, bool], *, bent: bool) -> Strand:
    """Return strands that follow each other as one, which is doubted if it bends in a gap."""
    width = max(piece.width for piece in pieces)
    joined = bridge([piece.curve for piece in pieces], width)
    doubts = tuple(dict.fromkeys(doubt for piece in pieces for doubt in piece.doubts))
    doubts += ("it bends where the mask is cut: these may be two ropes",) * bent
    if not _runs_from(joined.curve, pieces[0]):
        inside = inside[1], inside[0]
    return Strand(even(joined.curve, joined.bridged, width)[0], width, inside, doubts=doubts)


def _runs_from(curve: Array, piece: Strand) -> bool:
    """Return whether a curve begins, and does not end, near a piece of it."""
    first, last = (float(np.min(np.linalg.norm(piece.curve - curve[end], axis=1))) for end in (0, -1))
    return first <= last


def _rope(strand: Strand, region: Region) -> SceneObject:
    doubts = list(strand.doubts)
    ends = [strand.curve[:: 1 - 2 * e] for e in (0, 1) if strand.inside[e]]
    if any(reach_beyond(end, strand.width, region).sticks_out for end in ends):
        doubts.append("it ends on another rope, and something sticks out beyond it")
    if strand.closed:
        doubts.append("it is a closed ring: where it begins is unknown")
    hidden = ~region.carries(strand.curve)
    axis = FittedCurve.through(strand.curve, hidden, ambiguity="; ".join(dict.fromkeys(doubts)))
    return SceneObject(axis, strand.width)
