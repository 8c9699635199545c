"""Similarity transforms, which separate the position, heading and size of a shape from its form."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_ROUNDS: Final = 200
_CONVERGED: Final = 1e-12
_UNLIKE: Final = 0.05  # smallest scale of an aligned shape; below it the heading is arbitrary


class Similarity(NamedTuple):
    """Represent ``p = shift + turn * q`` with the first two coordinates as a complex number.

    The third coordinate is only shifted and scaled.

    Args:
        shift: The translation, of shape ``(2,)`` or ``(3,)``.
        turn: The scale times exp(i angle).
    """

    shift: Array
    turn: complex

    @classmethod
    def of(cls, points: Array, mean: Array, weight: Array) -> Similarity:
        """Return the transform that brings the mean shape closest to the points, by weighted least squares.

        With complex p and m, relative to their weighted means: ``turn = sum w conj(m) p / sum w |m|^2``. Source: T. F.
        Cootes et al., "Active Shape Models: Their Training and Application", Computer Vision and Image Understanding
        61(1), 1995, appendix A.

        Args:
            points: ``(N, D)`` points; only the first two coordinates are fitted.
            mean: ``(N, D)`` mean shape.
            weight: ``(N,)`` weights.
        """
        share = weight / weight.sum()
        middle, centre = share @ points, share @ mean
        z, m = _plane(points - middle), _plane(mean - centre)
        turn = complex(np.vdot(m, share * z) / np.vdot(m, share * m).real)
        return cls(middle - _turned(centre, turn), turn)

    def apply(self, points: Array) -> Array:
        """Transform points ``(N, D)`` of the mean shape."""
        return self.shift + _turned(points, self.turn)

    def undo(self, points: Array) -> Array:
        """Apply the inverse transform to points ``(N, D)``; the result is not finite if the scale is zero."""
        return _turned(points - self.shift, 1 / self.turn if self.turn else complex(np.nan))


def superimposed(points: Array) -> Array:
    """Remove position, heading and size from shapes by generalised Procrustes analysis: ``(F, N, D)`` -> ``(F, N, D)``.

    Each shape is transformed to the mean by its best similarity, which gives the next mean. The mean has the root mean
    square size of the shapes and their mean heading. Source: J. C. Gower, "Generalized Procrustes analysis",
    Psychometrika 40(1), 1975.

    Raises:
        ValueError: A shape differs so much from the others that its heading is arbitrary.
    """
    centred = points - points.mean(axis=1, keepdims=True)
    plane = centred[..., 0] + 1j * centred[..., 1]
    size = np.sqrt(np.mean(np.sum(np.abs(plane) ** 2, axis=1)))
    mean = plane[0]
    turn = np.ones(len(plane), complex)
    for _ in range(_ROUNDS):
        mean = mean * (size / np.linalg.norm(mean))
        turn = plane @ mean.conj() / size**2
        unlike = np.flatnonzero(np.abs(turn) < _UNLIKE)
        if unlike.size:
            raise ValueError(
                f"shape {unlike[0]} of {len(points)} is too unlike the others to be aligned: leave it out, "
                "or fit without alignment."
            )
        before, mean = mean, (plane / turn[:, None]).mean(axis=0)
        if np.linalg.norm(mean - before) < _CONVERGED * size:
            break
    # Up to here the heading is that of the first shape.
    heading = turn.sum() / abs(turn.sum()) if abs(turn.sum()) > _UNLIKE else 1.0
    flat = plane / turn[:, None] * heading
    return np.stack(
        [flat.real, flat.imag, *np.moveaxis(centred[..., 2:] / np.abs(turn)[:, None, None], -1, 0)], axis=-1
    )


def _plane(points: Array) -> npt.NDArray[np.complex128]:
    return points[..., 0] + 1j * points[..., 1]


def _turned(points: Array, turn: complex) -> Array:
    """Rotate and scale points ``(..., D)``."""
    out = points * abs(turn)
    x, y = points[..., 0], points[..., 1]
    out[..., 0] = turn.real * x - turn.imag * y
    out[..., 1] = turn.imag * x + turn.real * y
    return out
