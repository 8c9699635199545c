"""Rigid and similarity transforms that lay one set of points over another, by least squares.

``fit`` is for Python, in any dimension; the compiled functions below it do parts of the same in inner loops.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import compiled

Array = npt.NDArray[np.float64]

_SWEEPS: Final = 12
_PARALLEL: Final = 1e-14  # cosine: columns that lie so close to a right angle are orthogonal
_RANK: Final = 1e-12  # of the largest singular value: less is none
_ROOT_STEPS: Final = 40  # a triple root is approached by a third each time
_ROOT: Final = 3e-14  # of the cube of a root: the cubic is not known better
_COMPLEX: Final = np.array([1, 1j])


class Transform(NamedTuple):
    """A similarity transform: ``p = scale * rotation @ q + shift``; it is rigid if the scale is 1.

    Args:
        rotation: ``(D, D)`` proper rotation.
        shift: ``(D,)``.
        scale: The scale.
    """

    rotation: Array
    shift: Array
    scale: float

    def apply(self, points: Array) -> Array:
        """Transform points ``(..., D)``."""
        return self.scale * points @ self.rotation.T + self.shift

    @property
    def matrix(self) -> Array:
        """The homogeneous transform ``(D + 1, D + 1)``."""
        size = len(self.shift)
        matrix = np.eye(size + 1)
        matrix[:size, :size], matrix[:size, size] = self.scale * self.rotation, self.shift
        return matrix


def fit(before: Array, after: Array, weight: Array | None = None, *, scaled: bool = False) -> Transform:
    """Return the transform that minimises the weighted squares of ``after - T before``.

    In the plane, with the points as complex numbers relative to their means, ``scale * exp(i angle)`` is
    ``sum w conj(b) a / sum w |b|^2``; otherwise the rotation follows from the singular vectors of the covariance.

    Args:
        before: ``(N, D)``.
        after: ``(N, D)`` where these points are.
        weight: ``(N,)``, not all 0; None if all count alike.
        scaled: Whether the scale is fitted too; else it is 1.

    References:
        S. Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two Point Patterns", 1991.
    """
    share = np.full(len(before), 1 / len(before)) if weight is None else weight / weight.sum()
    middle, target = share @ before, share @ after
    before, after = before - middle, after - target
    weighted = share[:, None] * before
    square = max(float(np.vdot(weighted, before)), 1e-18)
    if before.shape[1] == 2:
        product = np.vdot(weighted @ _COMPLEX, after @ _COMPLEX)
        trace = abs(product)
        turn = product / trace if trace > 0 else 1.0 + 0.0j
        rotation = np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
    else:
        left, values, right = np.linalg.svd(after.T @ weighted)
        signs = np.ones(len(values))
        signs[-1] = np.sign(np.linalg.det(left) * np.linalg.det(right)) or 1.0
        rotation, trace = (left * signs) @ right, values @ signs
    scale = float(trace) / square if scaled else 1.0
    return Transform(rotation, target - scale * rotation @ middle, scale)


@compiled("(f8[:,::1],)")
def best_rotation(covariance: Array) -> Array:
    """Return the proper rotation R, ``(D, D)``, that makes the trace of R'A largest.

    With A the sum of the products of two sets of centred points, ``before.T @ after``, the points ``before @ R`` lie as
    near to ``after`` as a rotation can take them (W. Kabsch, Acta Cryst. A32, 1976). The singular vectors come from
    rotations of the columns against each other until they are orthogonal (M. R. Hestenes, "Inversion of Matrices by
    Biorthogonalization and Related Results", 1958), which small singular values survive.

    Args:
        covariance: ``(D, D)`` A; D is 2 or 3.
    """
    if len(covariance) == 2:
        along, across = covariance[0, 0] + covariance[1, 1], covariance[0, 1] - covariance[1, 0]
        reach = math.hypot(along, across)
        cosine, sine = (along / reach, across / reach) if reach > 0 else (1.0, 0.0)
        return np.array([[cosine, sine], [-sine, cosine]])
    left, right = covariance.copy(), np.eye(3)
    size = orthogonalized(left, right)
    first = int(np.argmax(size))
    least = int(np.argmin(size)) if size.min() < size[first] else 2
    second = 3 - first - least
    u, v = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):
        v[0, i], v[1, i] = right[i, first], right[i, second]
        u[0, i] = left[i, first] / size[first] if size[first] > 0 else 1.0 * (i == first)
        u[1, i] = left[i, second] / size[second] if size[second] > _RANK * size[first] else 0.0
    if not size[second] > _RANK * size[first]:  # any direction at a right angle to the first
        _across(u)
    _cross(u)
    _cross(v)
    rotation = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                rotation[i, j] += u[k, i] * v[k, j]
    return rotation


@compiled
def largest_trace(covariance: Array) -> float:
    """Return the trace of R'A for the best proper rotation R of a matrix A, see ``best_rotation``.

    It is the sum of the singular values, the least one negative if the determinant is. The square of the greatest is a
    root of a cubic, and the sum of the others follows from it, the determinant and the squares of the minors.
    """
    a, square, minors, determinant = covariance, 0.0, 0.0, 0.0
    if len(a) == 2:
        return math.sqrt((a[0, 0] + a[1, 1]) ** 2 + (a[0, 1] - a[1, 0]) ** 2)
    for i in range(3):
        for j in range(3):
            p, q, r, s = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            minor = a[p, r] * a[q, s] - a[p, s] * a[q, r]
            square, minors = square + a[i, j] * a[i, j], minors + minor * minor
            determinant += a[i, j] * minor / 3
    if square == 0:
        return 0.0
    most = square
    for _ in range(_ROOT_STEPS):  # Newton's method, which comes down to the greatest root
        over = ((most - square) * most + minors) * most - determinant**2
        if not over > _ROOT * most**3:
            break
        most -= over / ((3 * most - 2 * square) * most + minors)
    first = math.sqrt(most)
    both = determinant / first  # the product of the other two
    return first + math.sqrt(max((minors - both * both) / most + 2 * both, 0.0))


@compiled
def orthogonalized(left: Array, right: Array) -> Array:
    """Rotate the columns of a matrix until they are orthogonal, and those of another alike; return their lengths.

    Args:
        left: ``(3, 3)``, changed in place.
        right: ``(3, 3)``, changed in place.
    """
    for _ in range(_SWEEPS):
        turned = _made_orthogonal(left, right, 0, 1)
        turned |= _made_orthogonal(left, right, 0, 2)
        turned |= _made_orthogonal(left, right, 1, 2)
        if not turned:
            break
    size = np.empty(3)
    for k in range(3):
        size[k] = math.sqrt(left[0, k] ** 2 + left[1, k] ** 2 + left[2, k] ** 2)
    return size


@compiled
def _made_orthogonal(left: Array, right: Array, p: int, q: int) -> bool:
    """Rotate the columns p and q until those on the left are orthogonal, and return whether they moved."""
    one = other = both = 0.0
    for i in range(3):
        one += left[i, p] * left[i, p]
        other += left[i, q] * left[i, q]
        both += left[i, p] * left[i, q]
    if abs(both) <= _PARALLEL * math.sqrt(one * other):
        return False
    ratio = (other - one) / (2 * both)
    tangent = (1.0 if ratio >= 0 else -1.0) / (abs(ratio) + math.sqrt(1 + ratio * ratio))
    cosine = 1 / math.sqrt(1 + tangent * tangent)
    sine = cosine * tangent
    for i in range(3):
        a, b = left[i, p], left[i, q]
        left[i, p], left[i, q] = cosine * a - sine * b, sine * a + cosine * b
        a, b = right[i, p], right[i, q]
        right[i, p], right[i, q] = cosine * a - sine * b, sine * a + cosine * b
    return True


@compiled
def _across(rows: Array) -> None:
    """Set the second row of a matrix to a unit vector at a right angle to the first."""
    flat = 0
    for k in range(3):
        if abs(rows[0, k]) < abs(rows[0, flat]):
            flat = k
    away, length = rows[0, flat], 0.0
    for k in range(3):
        rows[1, k] = (k == flat) - away * rows[0, k]
        length += rows[1, k] ** 2
    for k in range(3):
        rows[1, k] /= math.sqrt(length)


@compiled
def _cross(rows: Array) -> None:
    """Set the third row of a matrix to the cross product of the first two."""
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        rows[2, k] = rows[0, i] * rows[1, j] - rows[0, j] * rows[1, i]


@compiled
def covariance_of(before: Array, after: Array, weight: npt.NDArray[Any]) -> tuple[Array, Array, Array]:
    """Return the weighted sum of the products of two sets of points about their means, and both means.

    Args:
        before: ``(N, D)``.
        after: ``(N, D)``.
        weight: ``(N,)`` how much each counts, or which of them count.

    Returns:
        ``(D, D)``, row a for coordinate a of the points before; ``(D,)``; ``(D,)``.
    """
    count, size = before.shape
    covariance, first, second = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    whole = max(1.0 * weight.sum(), 1e-18)
    for n in range(count):
        share = weight[n] / whole
        for a in range(size if share > 0 else 0):  # what does not count need not be a number
            first[a] += share * before[n, a]
            second[a] += share * after[n, a]
    for n in range(count):
        for a in range(size if weight[n] > 0 else 0):
            away = weight[n] * (before[n, a] - first[a])
            for b in range(size):
                covariance[a, b] += away * (after[n, b] - second[b])
    return covariance, first, second


@compiled("(f8[:,::1],)")
def spread_of(points: Array) -> float:
    """Return the mean square distance of points ``(N, D)`` from their mean."""
    count, total = len(points), 0.0
    for d in range(points.shape[1]):
        middle = 0.0
        for n in range(count):
            middle += points[n, d]
        for n in range(count):
            total += (points[n, d] - middle / count) ** 2
    return total / count


@compiled
def moved_onto(points: Array, before: Array, after: Array, weight: npt.NDArray[Any], scaled: bool) -> Array:
    """Return points ``(P, D)`` after the motion that takes others ``(N, D)`` nearest to where they are, see ``fit``.

    Args:
        points: ``(P, D)``.
        before: ``(N, D)``.
        after: ``(N, D)`` the same points after the motion.
        weight: ``(N,)`` how much each of them counts, or which of them count.
        scaled: Whether the motion scales too; else it is rigid.
    """
    covariance, first, second = covariance_of(before, after, weight)
    rotation, out, trace, square = best_rotation(covariance), np.empty_like(points), 0.0, 1e-18
    for d in range(before.shape[1]):
        for e in range(before.shape[1]):
            trace += rotation[d, e] * covariance[d, e]
        for n in range(len(before)):
            square += weight[n] * (before[n, d] - first[d]) ** 2 if weight[n] > 0 else 0.0
    scale = trace / square if scaled else 1.0
    for p in range(len(points)):
        for d in range(points.shape[1]):
            out[p, d] = second[d]
            for e in range(points.shape[1]):
                out[p, d] += scale * (points[p, e] - first[e]) * rotation[e, d]
    return out


@compiled
def flattened(points: Array) -> Array:
    """Return points in space ``(P, 3)`` in the plane along which they spread most, ``(P, 2)``."""
    covariance, middle, _ = covariance_of(points, points, np.ones(len(points)))
    axes, out = np.eye(3), np.zeros((len(points), 2))
    least = int(np.argmin(orthogonalized(covariance, axes)))
    for p in range(len(points)):
        for k in range(2):
            for d in range(3):
                out[p, k] += (points[p, d] - middle[d]) * axes[d, (least + 1 + k) % 3]
    return out
