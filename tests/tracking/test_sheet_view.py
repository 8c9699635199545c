"""What is known of a sheet without depth: what lies off its form is doubted, and what bends is learnt."""

from __future__ import annotations

import numpy as np
import pytest

from shape_obs.geometry.coons import FINE
from shape_obs.geometry.rotation import fit
from shape_obs.tracking.sheet_view import doubtful_places, learn_sheet

GAP = 8.0  # pixels between the points that are asked for
SIDES = np.array([64.0, 32.0, 64.0, 32.0])


def flat() -> np.ndarray:
    """Return a lattice of 64 x 32 pixels, (25, 25, 2)."""
    across, down = np.linspace(0, 64, FINE), np.linspace(0, 32, FINE)
    return np.stack(np.meshgrid(across, down), axis=-1)


def as_points(lattice: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(lattice.reshape(-1, 2))


def dented(depth: float) -> np.ndarray:
    """Return the same with a dent in the middle of its right side."""
    lattice = flat()
    column, row = np.linspace(0, 1, FINE), np.linspace(-1, 1, FINE)
    lattice[..., 0] -= depth * np.exp(-((row[:, None] / 0.2) ** 2)) * np.maximum(column - 0.5, 0) * 2
    return lattice


def moved(lattice: np.ndarray, turn: float = 0.4, scale: float = 1.02) -> np.ndarray:
    cos, sin = scale * np.cos(turn), scale * np.sin(turn)
    return lattice @ np.array([[cos, sin], [-sin, cos]]) + (100, 80)


@pytest.mark.parametrize("depth", [4.0, 6.0])
def test_a_dent_is_doubted_where_it_is(depth):
    doubted = doubtful_places(as_points(flat()), as_points(moved(dented(depth))), GAP).reshape(FINE, FINE)
    assert doubted[FINE // 2, -1]
    assert not doubted[:, : FINE // 2].any()
    assert not doubted[[0, -1]].any()


def test_what_is_where_it_was_or_bends_as_a_whole_is_not_doubted():
    assert not doubtful_places(as_points(flat()), as_points(moved(flat())), GAP).any()
    bent = flat()
    bent[..., 1] += 6 * np.sin(bent[..., 0] / 64 * np.pi)
    assert doubtful_places(as_points(flat()), as_points(moved(bent)), GAP).mean() < 0.03


def test_a_dent_is_learnt_slower_than_a_bend():
    bent = flat()
    bent[..., 1] += 2 * np.sin(bent[..., 0] / 64 * np.pi)
    gained = []
    for now in (dented(6.0), bent):
        known, _ = learn_sheet(as_points(flat()), as_points(now), SIDES)
        off = np.linalg.norm(now - flat(), axis=-1).ravel()
        changed = fit(known, as_points(flat()), scaled=True).apply(known) - as_points(flat())
        gained.append(np.linalg.norm(changed, axis=1)[off.argmax()])
    dent, bend = gained
    assert dent < 0.02
    assert bend > 0.02


@pytest.mark.parametrize(("nearer", "learnt"), [(1.02, 1.02), (0.98, 0.98), (1.3, 1.03)])
def test_a_sheet_that_comes_nearer_grows_by_three_percent_in_a_frame_at_most(nearer, learnt):
    """Without depth all sides grow together; in a frame of 30 a second none comes nearer by more."""
    _, sides = learn_sheet(as_points(flat()), as_points(flat() * nearer), SIDES)
    assert sides == pytest.approx(learnt * SIDES, rel=0.003)
