"""Features: a shape as numbers with units, a frame and finite bounds, one feature a file."""

from shape_obs.features.base import Feature, View, read_features
from shape_obs.features.points import Points2D, Points2DNormalized, Points3D
from shape_obs.features.status import Age, Ok, Valid
from shape_obs.features.vector import FeatureVector

__all__ = [
    "Age",
    "Feature",
    "FeatureVector",
    "Ok",
    "Points2D",
    "Points2DNormalized",
    "Points3D",
    "Valid",
    "View",
    "read_features",
]
