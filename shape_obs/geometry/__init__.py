"""Curves, lattices, outlines and topologies; nothing here depends on images."""
