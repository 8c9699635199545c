"""What a shape is fitted to: a region of an image, or a cloud of points in space."""

from __future__ import annotations

from shape_obs.image.region import Region
from shape_obs.point_cloud.cloud import Cloud

Body = Region | Cloud
