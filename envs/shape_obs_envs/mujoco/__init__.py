"""Environments simulated by MuJoCo."""
