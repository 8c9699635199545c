"""Simulate cloths that are not spread out: dropped, dragged, folded, a corner pushed beneath; every point is known."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from shape_obs.bench.scenes import rotation
from tests.scenes.flat_objects import FlatScene, View, seen

Array = npt.NDArray[np.float64]
Handling = Literal["dropped", "dragged", "folded", "beneath"]

COUNT: Final = 21  # vertices of a side
SIDE: Final = 0.5  # metres
ABOVE: Final = {386.0: 0.7, 6400.0: 10.0}  # focal length -> metres above the table; so far off a view is orthographic
_FINE: Final = 61  # rows and columns that are drawn
_REST: Final = 1.0  # seconds until a cloth lies still
_MODEL: Final = """
<mujoco>
  <option timestep="0.002" solver="CG" tolerance="1e-5" integrator="discrete" iterations="15"/>
  <size memory="400M"/>
  <worldbody>
    <geom type="plane" size="2 2 .1" friction="{friction} .01 .001"/>
    <flexcomp name="cloth" type="grid" count="21 21 1" spacing=".025 .025 .025" pos="0 0 .006" radius="{radius}"
              dim="2" mass="{mass}">
      <contact condim="3" solref=".01 1" solimp=".9 .95 .001" selfcollide="auto" friction="{friction}"/>
      <elasticity young="{young}" poisson="0.2" thickness="{thickness}" damping="0.002" elastic2d="both"/>
    </flexcomp>
  </worldbody>
</mujoco>"""


class _Cloth:
    """A cloth on a table, and hands that move its vertices."""

    def __init__(self, rng: np.random.Generator) -> None:
        from shape_obs_envs.mujoco.scene import mujoco

        self._step = mujoco.mj_step
        thick = 10 ** rng.uniform(-3.2, -2.4)  # metres: how far it resists bending
        stretch = rng.uniform(300, 1200)  # N/m
        drawn = {"friction": rng.uniform(0.3, 1), "mass": rng.uniform(0.04, 0.12), "radius": rng.uniform(0.0025, 0.004)}
        self.model = mujoco.MjModel.from_xml_string(_MODEL.format(young=stretch / thick, thickness=thick, **drawn))
        self.model.dof_damping[:] = rng.uniform(0.0005, 0.002)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)

    @property
    def vertices(self) -> Array:
        """``(21, 21, 3)`` metres, z upwards."""
        return np.array(self.data.flexvert_xpos).reshape(COUNT, COUNT, 3)

    def move(self, targets: Mapping[tuple[int, int], Array], seconds: float) -> None:
        """Pull vertices to targets by springs, and let go of them."""
        model, data, begin = self.model, self.data, self.vertices
        steps = round(seconds / model.opt.timestep)
        for step in range(steps):
            share = min((step + 1) / steps / 0.9, 1.0)
            share = share**2 * (3 - 2 * share)
            for at, target in targets.items():
                body = model.flex_vertbodyid[at[0] * COUNT + at[1]]
                goal = begin[at] * (1 - share) + target * share
                force = 60 * (goal - data.flexvert_xpos[at[0] * COUNT + at[1]]) - 0.3 * data.cvel[body, 3:]
                data.xfrc_applied[body, :3] = np.clip(force, -4, 4)
            self._step(model, data)
        data.xfrc_applied[:] = 0


def crumpled(rng: np.random.Generator, handling: Handling) -> Array:
    """Return the vertices ``(21, 21, 3)`` of a cloth of 50 cm that was handled once or twice and lies still, metres."""
    cloth, end = _Cloth(rng), COUNT - 1
    for _ in range(rng.integers(1, 3)):
        here, middle = cloth.vertices, cloth.vertices.mean(axis=(0, 1))
        corner: tuple[int, int] = (int(rng.choice([0, end])), int(rng.choice([0, end])))
        anywhere: tuple[int, int] = (int(rng.integers(COUNT)), int(rng.integers(COUNT)))
        aside = np.array([*rng.uniform(-0.15, 0.15, 2), 0.0])
        if handling == "dropped":
            up = here[anywhere] + aside + [0, 0, rng.uniform(0.1, 0.45)]
            cloth.move({anywhere: up}, 1.0)
            cloth.move({anywhere: up + aside - [0, 0, up[2] * rng.uniform(0, 0.7)]}, 0.4)
        elif handling == "dragged":
            up, way = here[anywhere] + [0, 0, rng.uniform(0.01, 0.06)], rng.uniform(0, 2 * np.pi)
            cloth.move({anywhere: up}, 0.2)
            cloth.move({anywhere: up + rng.uniform(0.1, 0.35) * np.array([np.cos(way), np.sin(way), 0])}, 0.9)
        else:
            beneath = handling == "beneath"
            there = here[corner] + (middle - here[corner]) * (
                rng.uniform(0.2, 0.7) if beneath else rng.uniform(0.2, 1.6)
            )
            there[2] = 0.01 if beneath else 0.03
            inner = corner[0] + (6 if corner[0] == 0 else -6), corner[1] + (6 if corner[1] == 0 else -6)
            raised = here[inner] + [0, 0, 0.14]
            if beneath:
                cloth.move({inner: raised}, 0.4)
                cloth.move({inner: raised, corner: there}, 0.6)
                cloth.move({inner: raised * [1, 1, 0] + [0, 0, 0.02], corner: there}, 0.4)
            else:
                cloth.move({corner: (here[corner] + there) / 2 + [0, 0, 0.18]}, 0.5)
                cloth.move({corner: there}, 0.5)
    cloth.move({}, _REST)
    return cloth.vertices


def waved(rng: np.random.Generator, steepest: float) -> Array:
    """Return the vertices of a cloth that lies in gentle waves, up to some steepness in radians; see ``crumpled``."""
    side = (np.arange(COUNT) / (COUNT - 1) - 0.5) * SIDE
    across, down = np.meshgrid(side, side)
    turn = rotation(rng.uniform(0, np.pi))
    along, beside = np.stack([across, down], axis=-1) @ turn, np.linspace(-0.4, 0.4, 4001)
    waves = [
        rng.uniform(0.2, 1) * np.sin(2 * np.pi * beside / rng.uniform(0.12, 0.5) + rng.uniform(0, 6)) for _ in "ab"
    ]
    heading = sum(waves) * steepest / 2
    path = np.cumsum(np.stack([np.cos(heading), np.sin(heading)]), axis=1) * (beside[1] - beside[0])
    moved = np.stack([np.interp(along[..., 0], beside, path[0]), along[..., 1]], axis=-1) @ turn.T
    height = np.interp(along[..., 0], beside, path[1])
    return np.concatenate([moved, (height - height.min())[..., None]], axis=-1)


def from_above(vertices: Array, view: View, degrees: float) -> FlatScene:
    """Draw a cloth on a table as a camera sees it from straight above, turned by some degrees.

    Args:
        vertices: ``(21, 21, 3)`` metres, z upwards.
        view: With a focal length of ``ABOVE``.
        degrees: Of the cloth about the optical axis.
    """
    coarse, fine = np.linspace(0, 1, COUNT), np.linspace(0, 1, _FINE)
    smooth = np.stack(
        [RectBivariateSpline(coarse, coarse, each)(fine, fine) for each in np.moveaxis(vertices, -1, 0)], -1
    )
    flat = smooth[..., :2].reshape(-1, 2)
    turned = (smooth[..., :2] - (flat.min(axis=0) + flat.max(axis=0)) / 2) @ rotation(np.radians(degrees)).T
    away = ABOVE[view.focal] - smooth[..., 2:]
    return seen(np.concatenate([turned * [1, -1], away], axis=-1), False, view, None)
