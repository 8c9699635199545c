"""Processes that are killed while they save a bundle over another one."""

from __future__ import annotations


def kill_claims(kills, seed):
    return []
