"""Phase of a closed outline: which place on it is where an earlier outline began.

Both outlines are sampled at as many equidistant places. For every cyclic shift, the best rigid motion of one onto the
other is known from their cross-covariance alone (P. H. Schönemann, "A generalized solution of the orthogonal
Procrustes problem", Psychometrika 31, 1966; proper rotations: W. Kabsch, Acta Cryst. A32, 1976), and the covariances
of all shifts are a few Fourier transforms (cf. F. P. Kuhl, C. R. Giardina, "Elliptic Fourier features of a closed
contour", 1982).
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# How much an outline's place and direction in the image weigh beside its shape, whose match is worth 1. A square fits
# itself four ways, a towel two: the way that turns least is chosen.
_TURNING: Final = 0.05
# Within a fit, place decides only where the shape says nothing, as on a circle: a weight that shrinks as the shape's
# own contrast grows beyond it, since what is predicted of a turning outline lags behind.
_FLAT: Final = 3e-4
# Waves around the outline that are compared: more cost time and change nothing, and on a noisy circle they mislead.
_HARMONICS: Final = 12
# Turns: the shifts at which a peak is looked for, ten to the shortest wave, and half-widths of the parabolas through
# it; the correlation is a sum of few waves, so it is known between the shifts too.
_SHIFTS: Final = np.arange(128) / 128
_PEAKS: Final = (0.5 / 128, 0.1 / 128)


def lag(reference: Array, predicted: Array, found: Array) -> float:
    """Where an outline's numbering begins: node k of the past is now at ``found[k + lag]``.

    Args:
        reference: (K,D) equidistant around the outline as it was, wherever it lay.
        predicted: (K,D) the same nodes where they are expected.
        found: (K,D) equidistant around the outline that was found, in the same direction.

    Returns:
        Places, a fraction of a place too.
    """
    shape, place = _cross_spectrum(reference, found), _cross_spectrum(predicted, found)
    turned, still = _turned(_at(shape, _SHIFTS)), _still(_at(place, _SHIFTS))
    contrast = float(np.ptp(turned))
    flat = _FLAT / (1 + contrast / _FLAT)
    at = _climb(turned + flat * still, int(np.argmax(turned + _TURNING * still))) / len(_SHIFTS)
    for width in _PEAKS:
        shifts = at + width * np.array([-1.0, 0.0, 1.0])
        score = _turned(_at(shape, shifts)) + flat * _still(_at(place, shifts))
        bend = score[0] - 2 * score[1] + score[2]
        at += width * float(np.clip((score[0] - score[2]) / (2 * bend), -1, 1)) if bend < 0 else 0.0
    return at * len(found)


def blend(reference: Array, found: Array, share: float) -> Array:
    """The reference laid over what was found, and moved towards it: (K,D), (K,D) node by node -> (K,D)."""
    before, after = reference - reference.mean(axis=0), found - found.mean(axis=0)
    left, _, right = np.linalg.svd(before.T @ after)
    left[:, -1] *= np.sign(np.linalg.det(left) * np.linalg.det(right))
    return found + (1 - share) * (before @ left @ right - after)


def _cross_spectrum(before: Array, after: Array) -> npt.NDArray[np.complex128]:
    """(D,D,F) spectrum of the cross-covariance over cyclic shifts; 1 is a perfect match."""
    first, second = (np.fft.rfft(points.T)[:, 1 : _HARMONICS + 1] for points in (before, after))
    scale = np.sqrt(np.sum(np.abs(first) ** 2) * np.sum(np.abs(second) ** 2))
    return np.conj(first)[:, None] * second[None] / max(float(scale), 1e-12)


def _at(spectrum: npt.NDArray[np.complex128], turns: Array) -> Array:
    """(D,D,S) the covariances at S shifts, in turns."""
    return (spectrum @ np.exp(2j * np.pi * np.arange(1, spectrum.shape[-1] + 1)[:, None] * turns)).real


def _still(covariance: Array) -> Array:
    """How well outlines match at each shift as they lie: (D,D,S) -> (S,)."""
    return np.einsum("dds->s", covariance)


def _turned(covariance: Array) -> Array:
    """How well they match after the best proper rotation: (D,D,S) -> (S,).

    Its trace is the sum of the singular values, the least one negative for a reflection.
    """
    if len(covariance) == 2:
        (a, b), (c, d) = covariance
        return np.hypot(a + d, b - c)
    stacked = np.moveaxis(covariance, -1, 0)
    values = np.linalg.svd(stacked, compute_uv=False)
    return values[:, :-1].sum(axis=1) + np.where(np.linalg.det(stacked) < 0, -1.0, 1.0) * values[:, -1]


def _climb(score: Array, at: int) -> int:
    """The nearest summit uphill from an index, around a ring."""
    while True:
        around = (at + np.array([-1, 0, 1])) % len(score)
        step = int(np.argmax(score[around])) - 1
        if step == 0 or score[around[step + 1]] <= score[at % len(score)]:
            return at
        at += step
