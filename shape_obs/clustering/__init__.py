"""Clusterers: samples -> centres, one file each. A name or a mapping chooses one: ``clustering="kmeans"``."""

from shape_obs.clustering.base import Centres, Clusterer, Clustering, SelfOrganisingMap

__all__ = ["Centres", "Clusterer", "Clustering", "SelfOrganisingMap"]
