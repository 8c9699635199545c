"""What a shape is fitted to: a region of an image, or a cloud of points in space."""

from __future__ import annotations

from shape_obs.cloud import Cloud
from shape_obs.region import Region

Body = Region | Cloud
