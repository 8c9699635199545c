"""Contour registration in space: find the place on a closed outline where an earlier outline began, as it bends.

As in the plane, the best rigid motion for every cyclic shift follows from the cross-covariances, see ``registration``.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from shape_obs.geometry.polyline import interpolate

Array = npt.NDArray[np.float64]

_FORGETTING: Final = 0.05  # by which share what is known follows what is found, in a frame
# As in the plane: what the place weighs against the form to choose a peak, and where the form says nothing.
_TURNING: Final = 0.05
_FLAT: Final = 3e-4
_HARMONICS: Final = 12
_SHIFTS: Final = 128
_PEAKS: Final = (0.5 / 128, 0.1 / 128)
_ALIKE: Final = 0.98  # a better match of forms in space is looked for near the expected place alone
_STEPS: Final = 5
_COMPARED: Final = 48  # of the nodes, at least
_BENT: Final = 2.0  # median distances: what lies farther off has bent
_FARTHEST: Final = 1 / 24  # of the outline
_STAY: Final = 0.01  # how much staying weighs against moving


def blend_space(reference: Array, found: Array) -> Array:
    """Return the reference laid over ``found`` and moved a little there, all ``(K, D)``."""
    before, after = reference - reference.mean(axis=0), found - found.mean(axis=0)
    left, _, right = np.linalg.svd(before.T @ after)
    left[:, -1] *= np.sign(np.linalg.det(left) * np.linalg.det(right))
    return found + (1 - _FORGETTING) * (before @ left @ right - after)


def index_shift_space(reference: Array, predicted: Array, found: Array, seen: Array) -> float:
    """Return what ``index_shift`` returns, by forms in space ``(K, 3)`` and places, expected and seen, ``(K, D)``."""
    shape, place = _cross_spectrum(reference, found), _cross_spectrum(predicted, seen)
    shifts = np.arange(_SHIFTS) / _SHIFTS
    turned, still = np.full(_SHIFTS, -np.inf), np.einsum("dds->s", _at(place, shifts))
    near = (int(np.argmax(still)) + np.arange(-_SHIFTS // 8, _SHIFTS // 8 + 1)) % _SHIFTS
    turned[near] = _rotated(_at(shape, shifts[near]))
    if turned.max() < _ALIKE or np.argmax(turned) in (near[0], near[-1]):  # it has turned far
        near = np.arange(_SHIFTS)
        turned = _rotated(_at(shape, shifts))
    flat = _FLAT / (1 + float(np.ptp(turned[near])) / _FLAT)
    score, at = turned + flat * still, int(np.argmax(turned + _TURNING * still))
    while max(low := score[(at - 1) % _SHIFTS], high := score[(at + 1) % _SHIFTS]) > score[at % _SHIFTS]:
        at += -1 if low >= high else 1
    at /= _SHIFTS
    for width in _PEAKS:
        shifts = at + width * np.array([-1.0, 0.0, 1.0])
        score = _rotated(_at(shape, shifts)) + flat * np.einsum("dds->s", _at(place, shifts))
        bend = score[0] - 2 * score[1] + score[2]
        at += width * float(np.clip((score[0] - score[2]) / (2 * bend), -1, 1)) if bend < 0 else 0.0
    return _without_bends(reference, found, at * len(found))


def _without_bends(reference: Array, found: Array, shift: float) -> float:
    """Refine a shift by those parts of an outline that have moved rigidly; the others count for little.

    Where a part of an outline bends out of the plane, the best rigid motion of the whole is off by up to half a gap of
    32 points. Gauss-Newton steps in the shift, the rotation and the translation, with weights that fall with the
    distance (D. Geman, D. E. McClure, "Statistical methods for tomographic image reconstruction", 1987), go over to
    the part that has not bent.
    """
    count, most = len(found), shift + _FARTHEST * len(found) * np.array([-1.0, 1.0])
    index = np.arange(0, count, max(count // _COMPARED, 1))
    reference, weight, around = reference[index], np.ones(len(index)), np.concatenate([found, found[:1]])
    ahead = np.roll(found, -1, axis=0) - found
    for _ in range(_STEPS):
        places = interpolate(around, np.arange(count + 1.0), np.asarray((index + shift) % count, np.float64))
        share = weight / weight.sum()
        middle = share @ places
        before = reference - share @ reference
        left, _, right = np.linalg.svd((before * share[:, None]).T @ (places - middle))
        left[:, -1] *= np.sign(np.linalg.det(left) * np.linalg.det(right))
        laid = before @ left @ right
        off = places - middle - laid
        far = np.linalg.norm(off, axis=1)
        weight = 1 / (1 + (far / max(_BENT * float(np.median(far)), 1e-9)) ** 2) ** 2
        moves = np.zeros((len(index), 3, 7))  # of the residual, by the shift, a rotation and a translation
        moves[:, :, 0] = ahead[np.floor(index + shift).astype(int) % count]
        x, y, z = laid.T
        moves[:, 1, 1], moves[:, 2, 1], moves[:, 0, 2] = z, -y, -z
        moves[:, 2, 2], moves[:, 0, 3], moves[:, 1, 3] = x, y, -x
        moves[:, (0, 1, 2), (4, 5, 6)] = -1
        flat, weights = moves.reshape(-1, 7), np.repeat(weight, 3)
        normal = (flat * weights[:, None]).T @ flat
        normal[0, 0] *= 1 + _STAY  # on a circle a shift is a rotation
        normal[np.diag_indices(7)] += 1e-12
        step = -np.linalg.solve(normal, (flat * weights[:, None]).T @ off.ravel())[0]
        shift = float(np.clip(shift + np.clip(step, -1, 1), *most))
    return shift


def _cross_spectrum(before: Array, after: Array) -> npt.NDArray[np.complex128]:
    """Return the spectrum of the cross-covariance over cyclic shifts, ``(D, D, F)``; a perfect match gives 1."""
    first, second = (np.fft.rfft(points.T)[:, 1 : _HARMONICS + 1] for points in (before, after))
    scale = np.sqrt(np.sum(np.abs(first) ** 2) * np.sum(np.abs(second) ** 2))
    return np.conj(first)[:, None] * second[None] / max(float(scale), 1e-12)


def _at(spectrum: npt.NDArray[np.complex128], turns: Array) -> Array:
    """Return the covariances at S shifts, in turns: ``(D, D, S)``."""
    return (spectrum @ np.exp(2j * np.pi * np.arange(1, spectrum.shape[-1] + 1)[:, None] * turns)).real


def _rotated(covariance: Array) -> Array:
    """Return how well they match after the best proper rotation: ``(D, D, S)`` -> ``(S,)``.

    Its trace is the sum of the singular values, the least one negative for a reflection.
    """
    stacked = np.moveaxis(covariance, -1, 0)
    values = np.linalg.svd(stacked, compute_uv=False)
    return values[:, :-1].sum(axis=1) + np.where(np.linalg.det(stacked) < 0, -1.0, 1.0) * values[:, -1]
