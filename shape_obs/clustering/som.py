"""Self-organising map: batch epochs from a good start.

References:
    T. Kohonen, "Self-Organizing Maps", Springer, 2001, the batch map; the local-linear neighbourhood follows the
    locally weighted regression of J. Fan, "Design-adaptive Nonparametric Regression", JASA 87, 1992.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shape_obs.compiled import NUMPY, Kernels
from shape_obs.geometry.samples import Samples
from shape_obs.geometry.topology import Topology


def fit(
    samples: Samples,
    start: npt.NDArray[np.float64],
    topology: Topology,
    sigmas: tuple[float, ...],
    kernels: Kernels = NUMPY,
) -> npt.NDArray[np.float64]:
    """Fit the map to the samples.

    Args:
        samples: M weighted points.
        start: (K,D) nodes.
        topology: How the nodes hang together.
        sigmas: Width of the neighbourhood in each epoch, node units; at least one.
        kernels: What runs the inner loops.

    Returns:
        (K,D) nodes in the order of ``start``, the pull of the averaging undone.
    """
    nodes = kernels.settle(samples.points, samples.weight, start, *topology.neighbourhoods(sigmas))
    return topology.unshrink(nodes, sigmas[-1], kernels)
