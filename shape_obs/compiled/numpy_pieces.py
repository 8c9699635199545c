"""Which rows of pixels hang together, on NumPy."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from shape_obs.compiled.interface import Indices


def pieces(runs: Indices) -> tuple[Indices, int]:
    """The 8-connected components of a mask from its rows of pixels.

    Exact, at a third of what labelling every pixel costs. Labels on a grid of 8 x 8 cells would be cheaper still, but
    pieces that share a cell or lie in neighbouring ones are one to it.

    Args:
        runs: (R,3) row, first column, column past the last one; top to bottom, left to right.

    Returns:
        (R,) the component of each, numbered as they first appear; how many there are.
    """
    if not len(runs):
        return np.empty(0, np.int64), 0
    row, start, stop = (runs - [runs[0, 0], runs[:, 1].min(), runs[:, 1].min()]).T
    line = row * (int(stop.max()) + 2)  # rows behind one another, too far apart to touch
    below = line + int(stop.max()) + 2
    # A run touches those of the next row that end at its first column or later and begin no later than its last + 1.
    first = np.searchsorted(line + stop, below + start, "left")
    past = np.searchsorted(line + start, below + stop, "right")
    ends = np.cumsum(np.maximum(past - first, 0))
    begins = np.concatenate([[0], ends])
    touched = np.arange(ends[-1]) + np.repeat(first - begins[:-1], np.diff(begins))
    graph = csr_matrix((np.ones(len(touched), np.int8), touched, begins), shape=(len(runs), len(runs)))
    count, label = connected_components(graph, directed=False)
    return label.astype(np.int64), int(count)
