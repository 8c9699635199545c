"""Features: numbers computed from a shape, with units, a frame and finite bounds."""

from shape_obs.features.crossings import Crossings
from shape_obs.features.curvature import Curvature, Tangents, TurningAngles
from shape_obs.features.distribution import PointDistribution
from shape_obs.features.feature import Block, Feature, FeatureContext, FeatureVector, read_features
from shape_obs.features.fourier import EllipticFourier, Fourier
from shape_obs.features.moments import ContourMoments, RegionMoments
from shape_obs.features.pca import PrincipalComponents
from shape_obs.features.points import Age, New, Ok, Points2D, Points2DNormalized, Points3D, Sigma, Valid
from shape_obs.features.pose import Centroid, Length, Orientation
from shape_obs.features.splines import Bezier, BSpline

__all__ = [
    "Age",
    "BSpline",
    "Bezier",
    "Block",
    "Centroid",
    "ContourMoments",
    "Crossings",
    "Curvature",
    "EllipticFourier",
    "Feature",
    "FeatureContext",
    "FeatureVector",
    "Fourier",
    "Length",
    "New",
    "Ok",
    "Orientation",
    "PointDistribution",
    "Points2D",
    "Points2DNormalized",
    "Points3D",
    "PrincipalComponents",
    "RegionMoments",
    "Sigma",
    "Tangents",
    "TurningAngles",
    "Valid",
    "read_features",
]
