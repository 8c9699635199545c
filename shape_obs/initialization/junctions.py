"""Where strands meet: the nodes of a skeleton gathered into zones that every rope passes straight through.

Strands that cross at a steep angle thin to nodes within one another's reach. At an acute angle, or side by side, they
share a branch for a while, from the node where they meet to the one where they part. A rope that passes through leaves
an even number of branches at a zone, so which odd zones share a branch is a matching (as in route inspection: Kwan,
"Graphic Programming Using Odd or Even Points", 1962).

Whether two strands run side by side along a branch that they share, or cross, is seen in the silhouette: side by side
they are as thick as two, and where one crosses the other they lie on top of each other and are as thick as one. Each
such waist is a crossing.
"""

from __future__ import annotations

from collections import Counter
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.polyline import arc_length
from shape_obs.initialization.gaps import NOISE, Lead, bending
from shape_obs.initialization.skeleton import Branch, Skeleton, degrees

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
Arm = tuple[int, int]  # a branch, and which of its ends

_END: Final = 8.0  # widths of a shared branch that a rope's end in a mask costs: no crossing shares as many
_MOST_WAYS: Final = 4096  # ways to match zones that are tried: twelve zones that are all linked have as many
_PER_WIDTH: Final = (3.0, 0.2)  # price of a width of a shared branch as thick as one strand, and as two side by side
_ALONE: Final = 0.56  # radius over width: one strand has 0.5, and is thicker by noise alone
_ONE: Final = 0.76  # radius over width, below which strands lie on each other: in crossings it is 0.5 to 0.71
_TWO: Final = 0.84  # radius over width, above which they lie side by side: there it is 0.9 to 1
_NECK: Final = 0.42  # radius over width: thinner than one strand is a neck, where two touch in a few pixels
_OVERLAPPING: Final = 0.9  # of the radii of two nodes: a shorter branch lies between strands, not along one
_BLOB: Final = 4.0  # widths: a shorter branch thicker than a strand lies where three or more cross in nearly one place
_JITTER: Final = 0.2  # widths within which the largest radius counts: a skeleton is a pixel off the axis at places


class Zones(NamedTuple):
    """Where strands meet.

    Args:
        kept: The branches that one strand runs along.
        shared: The branches that two run along.
        of: The zone of either end of every kept and shared branch.
        doubt: Why the shared branches may be others, in words; empty if they are not.
    """

    kept: tuple[int, ...]
    shared: tuple[int, ...]
    of: dict[Arm, int]
    doubt: str


def merge_nodes(skeleton: Skeleton) -> Skeleton:
    """Make one node of those whose discs in the mask overlap; the branches between them are left out.

    Three strands that cross in nearly one place are thinned to four nodes, with short branches between them that no
    strand runs along.
    """
    degree = degrees(skeleton.branches)
    is_inner = [_is_inner(branch, degree, skeleton.width) for branch in skeleton.branches]
    inner = [branch for branch, inside in zip(skeleton.branches, is_inner, strict=True) if inside]
    node = connected(max(degree, default=-1) + 1, np.array([branch.nodes for branch in inner], int).reshape(-1, 2))
    kept = (branch for branch, inside in zip(skeleton.branches, is_inner, strict=True) if not inside)
    renamed = (Branch(each.points, each.radius, (int(node[each.nodes[0]]), int(node[each.nodes[1]]))) for each in kept)
    return skeleton._replace(branches=tuple(renamed))


def _is_inner(branch: Branch, degree: Counter[int], width: float) -> bool:
    if min(degree[node] for node in branch.nodes) < 3 or branch.nodes[0] == branch.nodes[1]:
        return False
    if branch.length < _OVERLAPPING * float(branch.radius[0] + branch.radius[-1]):
        return True
    if branch.length >= _BLOB * width:
        return False
    typical = float(np.sort(branch.radius)[len(branch.radius) // 5]) / width
    return _ALONE < typical < _ONE


def find_zones(skeleton: Skeleton) -> Zones:
    """Gather the nodes of a skeleton into zones: those at the two ends of a shared branch are one."""
    branches, degree = skeleton.branches, degrees(skeleton.branches)
    shared, doubt = _matching(branches, degree, skeleton.width)
    joined = np.array([branches[i].nodes for i in shared], int).reshape(-1, 2)
    zone = connected(max(degree, default=-1) + 1, joined)
    of = {(i, end): int(zone[branch.nodes[end]]) for i, branch in enumerate(branches) for end in (0, 1)}
    return Zones(tuple(i for i in range(len(branches)) if i not in shared), shared, of, doubt)


def _matching(branches: tuple[Branch, ...], degree: Counter[int], width: float) -> tuple[tuple[int, ...], str]:
    """Return the branches that two strands share: each odd zone lies at one at most, or holds a rope's end.

    With them why they may be others: where very many ways to match the zones are possible, not all are tried.
    """
    odd = sorted(zone for zone, count in degree.items() if count % 2 and count > 1)
    place = {zone: i for i, zone in enumerate(odd)}
    links = [
        (price, *sorted(place[node] for node in branch.nodes), i)
        for i, branch in enumerate(branches)
        if branch.nodes[0] != branch.nodes[1]
        and all(node in place for node in branch.nodes)
        and (price := _price(branch, width)) < 2 * _END  # a dearer one is never shared
    ]
    # Zones that are linked come one after the other, or every way to match some would be tried with every other one's.
    group = connected(len(odd), np.array([link[1:3] for link in links], int).reshape(-1, 2))
    bit = {zone: k for k, zone in enumerate(np.argsort(group, kind="stable").tolist())}
    ways: list[list[tuple[float, int, int]]] = [[] for _ in odd]
    for price, first, second, i in links:
        low, high = sorted((bit[first], bit[second]))
        ways[low].append((price, high, i))
    known: dict[int, tuple[float, tuple[int, ...]]] = {0: (0.0, ())}

    def best(left: int) -> tuple[float, tuple[int, ...]]:
        """Return the cheapest way to match the zones in a set of bits, or one of the cheapest if there are too many."""
        if left in known:
            return known[left]
        low = (left & -left).bit_length() - 1
        rest = left & ~(1 << low)
        cost, chosen = best(rest)
        options = [(_END + cost, chosen)]
        for price, high, i in ways[low]:
            if rest >> high & 1 and len(known) <= _MOST_WAYS:
                cost, chosen = best(rest & ~(1 << high))
                options.append((price + cost, (*chosen, i)))
        known[left] = min(options)
        return known[left]

    shared = best((1 << len(odd)) - 1)[1]
    crowded = f"strands meet in {len(odd)} places, too close together to tell them apart"
    return shared, crowded if len(known) > _MOST_WAYS else ""


def connected(count: int, pairs: Index) -> Index:
    """Return the component of each of ``count`` places, of which pairs ``(L, 2)`` are connected, as they appear."""
    label, before = np.arange(count), np.zeros(count, int)
    while not np.array_equal(label, before):  # the least number spreads; a joint has a few pixels
        before = label.copy()
        np.minimum.at(label, pairs, label[pairs].min(axis=1, keepdims=True))
    return np.unique(label, return_inverse=True)[1]


def _price(branch: Branch, width: float) -> float:
    """Return the cost of sharing a branch: its length in widths, more where it is slender."""
    slender = np.interp(branch.radius / width, (_ALONE, _TWO), _PER_WIDTH)
    return branch.length / width * float(slender.mean())


class Overlap(NamedTuple):
    """Two strands along a shared branch.

    Args:
        pairs: Which strand comes out as which.
        paths: ``(P, 2)`` pixels each, the centre of either strand on the way, in the direction of its pair.
        doubt: Why this may be wrong, or nothing.
    """

    pairs: tuple[tuple[Arm, Arm], tuple[Arm, Arm]]
    paths: tuple[Array, Array]
    doubt: str

    @property
    def denied(self) -> tuple[tuple[Arm, Arm], ...]:
        """The pairs that the silhouette contradicts."""
        (a, b), (c, d) = self.pairs
        return (a, d), (c, b), (a, c), (b, d)


def follow(branch: Branch, starts: list[Arm], ends: list[Arm], leads: dict[Arm, Lead], width: float) -> Overlap | None:
    """Follow two strands along the branch they share; None where the branch is too thin to decide.

    Args:
        branch: With the skeleton's radii.
        starts: The two strands at its first node.
        ends: The two strands at its last node.
        leads: How they leave.
        width: Of one strand, pixels.
    """
    if float(branch.radius.min()) < _NECK * width:
        return None
    side, doubt, clear = _sides(branch, width)
    if not clear:
        return None
    arc = arc_length(np.ascontiguousarray(branch.points))
    near, far = np.searchsorted(arc, (min(width, arc[-1]), max(arc[-1] - width, 0.0)))
    behind = np.mean([leads[arm].point for arm in starts], axis=0)
    ahead = np.mean([leads[arm].point for arm in ends], axis=0)
    first = _by_side(starts, leads, behind, branch.points[near] - behind)
    last = _by_side(ends, leads, ahead, ahead - branch.points[far])
    if side[-1] != side[0]:
        last = last[::-1]
    tangent = np.gradient(branch.points, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    offset = (side * np.maximum(branch.radius - width / 2, 0.0))[:, None] * normal
    paths = branch.points - offset, branch.points + offset
    return Overlap(((first[0], last[0]), (first[1], last[1])), paths, doubt)


def is_bent(overlap: Overlap, leads: dict[Arm, Lead]) -> bool:
    """Return whether two strands would bend less if each went on the other way than along a branch that they share."""
    (a, b), (c, d) = overlap.pairs
    bends = [sum(bending(leads[p], leads[q]) for p, q in ((a, x), (c, y))) for x, y in ((b, d), (d, b))]
    return bends[0] - bends[1] > NOISE


def _by_side(arms: list[Arm], leads: dict[Arm, Lead], middle: Array, ahead: Array) -> list[Arm]:
    """Return the strands from left to right, looking ahead, as the image is seen."""
    return sorted(arms, key=lambda arm: float((leads[arm].point - middle) @ (-ahead[1], ahead[0])))


def _sides(branch: Branch, width: float) -> tuple[npt.NDArray[np.intp], str, bool]:
    """Return on which side a strand runs that begins on the right ``(1)``: ``(P,)`` 1 or -1.

    With it why the sides may be wrong, or nothing: a waist of strands that cross at 25 degrees is two widths long, a
    little longer where they bend, and along a much longer one strands may change sides unseen.
    """
    from scipy.ndimage import maximum_filter1d  # takes 0.2 s to import

    arc = arc_length(np.ascontiguousarray(branch.points))
    steps = round(_JITTER * width * (len(arc) - 1) / max(float(arc[-1]), 1e-9))
    relative = maximum_filter1d(branch.radius, 2 * steps + 1) / width
    side = np.ones(len(arc), np.intp)
    doubt = ""
    start: int | None = None
    for i, value in enumerate(relative):
        if start is None and value < _ONE:
            start = i
        if start is not None and (value > _TWO or i == len(arc) - 1):
            side[(start + i + 1) // 2 :] *= -1
            if arc[i] - arc[start] > _END * width:
                doubt = f"strands lie on each other for {arc[i] - arc[start]:.0f} px: which comes out where is a guess"
            start = None
    return side, doubt, not _ONE <= relative.min() < _TWO
