"""Geometry of point clouds: thickness, voxels, geodesics, unrolling. Knows arrays alone."""
