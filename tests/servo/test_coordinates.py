"""ShapeServo with some values of an action only."""

from __future__ import annotations

import numpy as np
import pytest
from linear_plant import Plant, servo_of

from shape_obs.servo import Excitation, ShapeServo


def test_only_the_named_values_move():
    plant = Plant(actions=4)
    plant.matrix[:, [0, 3]] = 0
    plant.goal = plant.matrix @ np.array([0.0, 6.0, -4.0, 0.0])
    servo = servo_of(plant, "rls", coordinates=[1, 2])
    actions = plant.run(servo, 80)
    assert not actions[:, [0, 3]].any()
    assert actions[:8, 1:3] == pytest.approx(Excitation().actions(2))
    assert plant.away() < 0.1
    servo.reset()
    plant.run(servo, 8)
    servo.withheld()
    plant.run(servo, 30)
    assert plant.away() < 0.1


@pytest.mark.parametrize("coordinates", [[], [0, 0], [-1], [0.5]])
def test_other_indices_are_refused(coordinates):
    with pytest.raises(ValueError, match="coordinates: expected different indices of values of an action"):
        ShapeServo("rls", coordinates=coordinates)


def test_they_must_be_within_the_action():
    plant = Plant()
    with pytest.raises(ValueError, match=r"coordinates: expected indices below 3, the size of actions, got \[1, 3\]"):
        servo_of(plant, coordinates=[1, 3]).act(plant.observation())
