"""Clusterers: samples -> centres, one file each. A name or a mapping chooses one: ``clustering="kmeans"``."""

from shape_obs.clustering.base import Centres, Clusterer, Clustering, SelfOrganisingMap
from shape_obs.clustering.fcm import FuzzyCMeans
from shape_obs.clustering.gmm import GaussianMixture
from shape_obs.clustering.kmeans import KMeans
from shape_obs.clustering.kohonen import Kohonen

__all__ = [
    "Centres",
    "Clusterer",
    "Clustering",
    "FuzzyCMeans",
    "GaussianMixture",
    "KMeans",
    "Kohonen",
    "SelfOrganisingMap",
]
