"""Fit shapes in space: deprojection, voxels, geodesics, unrolling."""
