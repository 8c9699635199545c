"""A pixel rule from colours that were learned from clicks: a mixture of the object's colours against all others.

The mixtures are small enough for a config file, and a rule of colours alone compiles to a table, so that a frame costs
what it costs with a range of hues.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from shape_obs.image.segmentation import ColourRule
from shape_obs.spec import Spec, SpecError

Array = npt.NDArray[np.float64]

#: Width of the cells of 8-bit Lab in which all colours count as one.
CELL: Final = 2
_CELLS: Final = 256 // CELL
# Of 8-bit Lab in OpenCV.
_ZERO: Final = np.array([0.0, 128.0, 128.0])
_SCALE: Final = np.array([100 / 255, 1.0, 1.0])
_UNKNOWN: Final = 0.02  # weight of colours that are like nothing in the photo
_GAMUT: Final = 100 * 150 * 150.0  # size of the space of colours in Lab
_REACH: Final = 6.0  # standard deviations; farther colours are not the object's
_FEWEST: Final = 30  # samples for each colour of a mixture
_SPREAD: Final = 4.0  # least variance of a colour: noise, and what is between two cells
_KEPT: Final = 16  # tables
_CORE: Final = 0.3  # share of a mask that is not its border, at least, for the border to be left out
_NEAR: Final = 25  # pixels around an object that count as its surroundings
# Of the object and of all else: samples, and colours of a mixture.
_SAMPLES, _COLOURS = (800, 700), (4, 6)
#: Factors by which the light may change in later frames.
LIGHTS: Final = (1.0, 0.85, 1.15)
_STRICTNESS: Final = (0.0, -3.0, -1.5, 1.5, 3.0, 5.0, 8.0)


@dataclass(frozen=True)
class ColourGaussian(Spec):
    """One colour with its spread.

    Args:
        weight: Its share of the pixels.
        mean: (L, a, b) of CIE Lab; L 0...100.
        covariance: Upper triangle of the covariance: LL, La, Lb, aa, ab, bb.
    """

    weight: float
    mean: tuple[float, float, float]
    covariance: tuple[float, float, float, float, float, float]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0 < self.weight < np.inf and np.isfinite([*self.mean, *self.covariance]).all()):
            raise SpecError(f"colour: expected weight > 0 and finite numbers, got {self.weight} and {self.mean}.")
        if np.linalg.eigvalsh(self.matrix).min() <= 0:
            raise SpecError(f"colour: covariance {self.covariance} is not positive definite.")

    @cached_property
    def matrix(self) -> Array:
        """The covariance, ``(3, 3)``."""
        return np.array(self.covariance)[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]


@dataclass(frozen=True)
class ClickedColours(ColourRule, kind="click"):
    """Pixels whose colour is more probable on the object than elsewhere.

    ``propose_segmentation`` learns the colours from clicks on an image.

    Args:
        picks: (u, v) of the clicks on the object; kept for the record, no pixel is read there again.
        nots: (u, v) of the clicks that are not on the object.
        object: The colours of the object, as a mixture.
        background: The colours of everything else.
        strictness: Natural logarithm of how many times as probable a colour must be on the object as elsewhere.
    """

    picks: tuple[tuple[float, float], ...] = ()
    nots: tuple[tuple[float, float], ...] = ()
    object: tuple[ColourGaussian, ...] = ()
    background: tuple[ColourGaussian, ...] = ()
    strictness: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (self.object and self.background):
            raise SpecError(
                "click: the colours are missing; shape_obs.clicks.propose_segmentation(rgb, picks) learns "
                "them from an image, as `shape-obs detect IMAGE --pick u,v` does."
            )

    @cached_property
    def _hash(self) -> int:
        return hash((self.object, self.background, self.strictness, self.open, self.close, self.min_area))

    def __hash__(self) -> int:
        """Return a hash that is computed once: tables are looked up by rule in every frame."""
        return self._hash

    def matches(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
        """Return the mask of an image: ``(h, w, 3)`` uint8 -> ``(h, w)`` bool."""
        return self.log_odds(rgb) > 0

    def log_odds(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        """Return how far each pixel's colour is above the strictness, ``(h, w)``, natural log; -inf: impossible."""
        return _odds_table(self.object, self.background)[cells_of(rgb)] - np.float32(self.strictness)


def fit_rule(rgb: npt.NDArray[np.uint8], mask: npt.NDArray[np.bool_]) -> ClickedColours | None:
    """Return the rule that gives a mask again as well as colours alone can; None for a mask with hardly an outside.

    A mixture of colours is fitted to the mask and another one to all else, as in GrabCut (Rother, Kolmogorov and Blake,
    2004), but without a smoothness term, which would cut thin wires off.

    Args:
        rgb: ``(H, W, 3)`` uint8.
        mask: ``(H, W)`` bool.
    """
    inside, outside = (cv2.distanceTransform(side.view(np.uint8), cv2.DIST_C, 3) for side in (mask, ~mask))
    inner, away, near = inside > 1, outside > 2, (outside > 2) & (outside <= _NEAR)
    if np.count_nonzero(inner) < _CORE * np.count_nonzero(mask):
        inner = mask  # at the border colours are mixed, but nothing else is left of it
    if not inner.any() or np.count_nonzero(away) < _FEWEST:
        return None
    smooth, rng = cv2.medianBlur(rgb, 3).reshape(-1, 1, 3), np.random.default_rng(0)

    def sample(part: npt.NDArray[np.bool_], count: int) -> Array:
        chosen = np.flatnonzero(part)
        chosen = chosen if len(chosen) <= count else rng.choice(chosen, count, replace=False)
        gain = rng.choice(LIGHTS, len(chosen))[:, None, None]
        lab = cv2.cvtColor(np.clip(smooth[chosen] * gain, 0, 255).astype(np.uint8), cv2.COLOR_RGB2LAB)
        return np.asarray((lab[:, 0] - _ZERO) * _SCALE, np.float64)

    ground = np.concatenate([sample(near, _SAMPLES[1]), sample(away, _SAMPLES[1])])
    colours = fit_colours(sample(inner, _SAMPLES[0]), _COLOURS[0]), fit_colours(ground, _COLOURS[1])
    odds = _odds_table(*colours)[cells_of(rgb)]
    # Intersection over union of what is above each strictness with the mask.
    both = np.array([np.count_nonzero((odds > level) & mask) for level in _STRICTNESS])
    found = np.array([np.count_nonzero(odds > level) for level in _STRICTNESS])
    best = int(np.argmax(both / (np.count_nonzero(mask) + found - both)))
    return ClickedColours(object=colours[0], background=colours[1], strictness=_STRICTNESS[best])


def fit_colours(colours: Array, count: int) -> tuple[ColourGaussian, ...]:
    """Fit a mixture of at most ``count`` Gaussians to ``(K, 3)`` Lab colours."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture
    from threadpoolctl import threadpool_limits

    count = min(count, max(1, len(colours) // _FEWEST))
    mixture = GaussianMixture(count, reg_covar=_SPREAD, max_iter=12, tol=1e-2, init_params="k-means++", random_state=0)
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # nearly there is good enough
        mixture.fit(colours)
    upper = np.triu_indices(3)
    fitted: Any = mixture
    parts = zip(fitted.weights_, fitted.means_, fitted.covariances_, strict=True)
    return tuple(
        ColourGaussian(max(round(float(w), 4), 1e-4), *(tuple(np.round(x, 2).tolist()) for x in (m, c[upper])))
        for w, m, c in parts
    )


def cells_of(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.int32]:
    """Return the cell of Lab of each pixel: ``(h, w, 3)`` uint8 -> ``(h, w)`` int32."""
    cell = (cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB) // CELL).astype(np.int32)
    return (cell[..., 0] * _CELLS + cell[..., 1]) * _CELLS + cell[..., 2]


@lru_cache(maxsize=_KEPT)
def _odds_table(inside: tuple[ColourGaussian, ...], outside: tuple[ColourGaussian, ...]) -> npt.NDArray[np.float32]:
    """Return how much more probable each cell of Lab is inside than outside, natural log; far from the object -inf."""
    near = np.zeros((_CELLS, _CELLS, _CELLS), np.bool_)
    for each in inside:
        reach = _REACH * np.sqrt(np.diag(each.matrix))
        ends = ((np.array([each.mean - reach, each.mean + reach]) / _SCALE + _ZERO) / CELL).clip(0, _CELLS)
        near[tuple(slice(int(first), int(np.ceil(last)) + 1) for first, last in ends.T)] = True
    middles = np.argwhere(near).astype(np.float64) * CELL + (CELL - 1) / 2  # (K, 3) of the cells
    lab = np.asarray((middles - _ZERO) * _SCALE, np.float64)
    unknown = np.full((1, len(lab)), np.log(_UNKNOWN / _GAMUT))
    others = np.concatenate([_log_densities(lab, outside), unknown])
    table = np.full(near.size, -np.inf, np.float32)
    table[near.ravel()] = np.logaddexp.reduce(_log_densities(lab, inside)) - np.logaddexp.reduce(others)
    return table


def _log_densities(lab: Array, mixture: tuple[ColourGaussian, ...]) -> Array:
    """Return the weighted log density of each colour in each Gaussian: ``(K, 3)`` -> ``(G, K)``."""
    rows = []
    for each in mixture:
        inverse = np.linalg.cholesky(np.linalg.inv(each.matrix))
        scale = np.log(each.weight) - 1.5 * np.log(2 * np.pi) + np.log(np.diag(inverse)).sum()
        rows.append(scale - 0.5 * (((lab - each.mean) @ inverse) ** 2).sum(axis=1))
    return np.array(rows)
