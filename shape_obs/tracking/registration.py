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

from shape_obs.compiled import NUMPY, Kernels
from shape_obs.compiled.interface_outline import FLAT, HARMONICS, PEAKS, SHIFTS, TURNING

Array = npt.NDArray[np.float64]

_AT: Final = np.arange(SHIFTS) / SHIFTS  # turns


def lag(reference: Array, predicted: Array, found: Array, kernels: Kernels = NUMPY) -> float:
    """Where an outline's numbering begins: node k of the past is now at ``found[k + lag]``.

    Args:
        reference: (K,D) equidistant around the outline as it was, wherever it lay.
        predicted: (K,D) the same nodes where they are expected.
        found: (K,D) equidistant around the outline that was found, in the same direction.
        kernels: What runs the inner loops.

    Returns:
        Places, a fraction of a place too.
    """
    if found.shape[1] == 2:
        return kernels.lag(reference, predicted, found)
    shape, place = _cross_spectrum(reference, found), _cross_spectrum(predicted, found)
    turned, still = _turned(_at(shape, _AT)), _still(_at(place, _AT))
    contrast = float(np.ptp(turned))
    flat = FLAT / (1 + contrast / FLAT)
    at = _climb(turned + flat * still, int(np.argmax(turned + TURNING * still))) / SHIFTS
    for width in PEAKS:
        shifts = at + width * np.array([-1.0, 0.0, 1.0])
        score = _turned(_at(shape, shifts)) + flat * _still(_at(place, shifts))
        bend = score[0] - 2 * score[1] + score[2]
        at += width * float(np.clip((score[0] - score[2]) / (2 * bend), -1, 1)) if bend < 0 else 0.0
    return at * len(found)


def blend(reference: Array, found: Array, share: float, kernels: Kernels = NUMPY) -> Array:
    """The reference laid over what was found, and moved towards it: (K,D), (K,D) node by node -> (K,D)."""
    if found.shape[1] == 2:
        return kernels.blend(reference, found, share)
    before, after = reference - reference.mean(axis=0), found - found.mean(axis=0)
    left, _, right = np.linalg.svd(before.T @ after)
    left[:, -1] *= np.sign(np.linalg.det(left) * np.linalg.det(right))
    return found + (1 - share) * (before @ left @ right - after)


def _cross_spectrum(before: Array, after: Array) -> npt.NDArray[np.complex128]:
    """(D,D,F) spectrum of the cross-covariance over cyclic shifts; 1 is a perfect match."""
    first, second = (np.fft.rfft(points.T)[:, 1 : HARMONICS + 1] for points in (before, after))
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
