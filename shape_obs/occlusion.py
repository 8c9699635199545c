"""Occlusion: which piece of a known rope a visible curve is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.form import Curve
from shape_obs.tracking import Prediction

Array = npt.NDArray[np.float64]


def follow_chain(form: Curve, prediction: Prediction) -> Curve:
    """The curve in the prediction's direction."""
    count = len(prediction.nodes)
    centres = form.at((np.arange(count) + 0.5) * (form.size / count))
    forward, backward = (float(np.sum((nodes - prediction.nodes) ** 2)) for nodes in (centres, centres[::-1]))
    return form if forward <= backward else form.reversed()
