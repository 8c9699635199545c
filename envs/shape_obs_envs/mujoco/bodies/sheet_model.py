"""The MJCF of a sheet: a grid of point masses, tendons between them, grippers at two corners, a skin to see it by.

The tendons are springs that also resist pushing, and do not stretch beyond their length: along the grid and, free to
stretch, across its cells (shear) and over every second mass (bending). A sheet that is pushed therefore buckles.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from shape_obs_envs.mujoco.bodies.base import GRIPPERS
from shape_obs_envs.mujoco.bodies.sheet_mesh import SKIN, SheetGrid

#: Texels of the texture, down and across.
PRINT = 64, 128
_HIDDEN = 4  # a group that is not drawn
_HEAVY = 1.0  # mass of a corner, whose motion is given: no pull of the sheet holds it up


@dataclass(frozen=True)
class SheetSpec:
    """Size and material of the sheet. Row 0 is the held edge, column 0 the side of gripper 0; lengths in metres.

    Attributes:
        width: Length of the held edge.
        depth: Length of the two sides.
        rows: Masses from the held edge to the free one.
        cols: Masses along the held edge.
        subdivision: Fine steps that the drawn surface takes from mass to mass.
        lift: Height of the sheet's surface above the table that it lies on.
        mass: Of each mass [kg].
        gravity: [m/s2]; less than on Earth, so that the load on the two held corners stays small.
        stretch: Stiffness [N/m] along the grid, within the limit.
        shear: Stiffness [N/m] of the cells' diagonals.
        bending: Stiffness [N/m] over every second mass.
        damping: Of each tendon [N s/m].
        drag: Of the air on each mass [N s/m].
        friction: Coefficient of friction on the table.
        creep: Speed [m/s] at which friction reaches half its value; what lies on the table and is pulled less moves
            slower than that.
        timestep: Of the physics [s].
        rgba: Colour.
    """

    width: float = 0.36
    depth: float = 0.18
    rows: int = 7
    cols: int = 13
    subdivision: int = 3
    lift: float = 0.001
    mass: float = 0.001
    gravity: float = 6.0
    stretch: float = 3.0
    shear: float = 2.0
    bending: float = 2.0
    damping: float = 0.001
    drag: float = 0.02
    friction: float = 0.5
    creep: float = 0.0001
    timestep: float = 1 / 160
    rgba: tuple[float, float, float, float] = (0.05, 0.25, 0.95, 1.0)

    @property
    def grid(self) -> SheetGrid:
        """The grid of masses and of the surface through them."""
        return SheetGrid(self.rows, self.cols, self.subdivision, self.lift)


def sheet_bodies(spec: SheetSpec) -> str:
    """MJCF of the masses, flat about the world's origin, held edge at +y, and of the two grippers."""
    rest = _rest(spec)
    table = f'range="0 1" {_limit(spec)}'
    parts = []
    # Column by column: the solver's matrices are banded by the number of masses in one.
    for j in range(spec.cols):
        for i in range(spec.rows):
            held = i == 0 and j in (0, spec.cols - 1)
            parts.append(
                f'<body name="{_mass(i, j)}" pos="{_numbers(rest[i * spec.cols + j])}" gravcomp="{int(held)}">'
                f'<inertial pos="0 0 0" mass="{_HEAVY if held else spec.mass}" diaginertia="1e-7 1e-7 1e-7"/>'
                f'<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
                f'<joint type="slide" axis="0 0 1" damping="{spec.drag}" {"" if held else table}/>'
                f'<site name="{_mass(i, j)}" group="{_HIDDEN}"/></body>'
            )
    parts += [
        f'<body name="{name}" mocap="true" pos="{_numbers(at)}">{_jaw()}</body>'
        for name, at in zip(GRIPPERS, rest[[0, spec.cols - 1]], strict=True)
    ]
    return "\n".join(parts)


def sheet_sections(spec: SheetSpec) -> str:
    """MJCF of the solver's settings, the tendons and the skin: sections beside the worldbody."""
    return f"""
<option timestep="{spec.timestep}" gravity="0 0 {-spec.gravity}" viscosity="0" solver="Newton" jacobian="sparse"
        iterations="10" ls_iterations="10" tolerance="1e-6"><flag gravity="enable"/></option>
<tendon>{"".join(_tendons(spec))}</tendon>
<asset>
  <texture name="{SKIN}" type="2d" builtin="flat" rgb1="1 1 1" width="{PRINT[1]}" height="{PRINT[0]}"/>
  <material name="{SKIN}" texture="{SKIN}" specular="0" shininess="0"/>
</asset>
<deformable>{_skin(spec)}</deformable>
<custom><numeric name="{SKIN}" data="{spec.rows} {spec.cols} {spec.subdivision} {spec.lift}"/></custom>"""


def bending_tendons(spec: SheetSpec) -> int:
    """How many of the tendons, the last ones, resist bending."""
    return spec.rows * (spec.cols - 2) + (spec.rows - 2) * spec.cols


def _limit(spec: SheetSpec) -> str:
    """Attributes of a limit, twice as stiff as MuJoCo's stiffest time constant: all of it pulls at two corners."""
    stiffness, damping = 0.5 / spec.timestep**2, 1 / spec.timestep
    return f'limited="true" solreflimit="-{stiffness} -{damping}" solimplimit=".95 .99 .001"'


def _mass(row: int, col: int) -> str:
    return f"mass{row}_{col}"


def _jaw() -> str:
    """The gripper's looks: a box beyond the held edge, out of the sheet's plane and never above the held corner.

    y points away from the sheet along the table. The gap is as wide as the box reaches down: so no line of sight from
    a camera on the sheet's side that meets the sheet is cut within 45 degrees of the vertical, unless the sheet is
    folded over that edge.
    """
    return '<geom type="box" size=".009 .012 .003" pos="0 .019 -.004" rgba=".2 .2 .2 1"/>'


def _tendons(spec: SheetSpec) -> Iterator[str]:
    across, down = spec.width / (spec.cols - 1), spec.depth / (spec.rows - 1)
    # way (rows, cols), stiffness, whether it may not stretch
    kinds = [
        ((0, 1), spec.stretch, True),
        ((1, 0), spec.stretch, True),
        ((1, 1), spec.shear, False),
        ((1, -1), spec.shear, False),
        ((0, 2), spec.bending, False),
        ((2, 0), spec.bending, False),
    ]
    for (rows, cols), spring, taut in kinds:
        length = math.hypot(rows * down, cols * across)
        range_ = f'range="0 {length}" {_limit(spec)}' if taut else ""
        for i in range(spec.rows - rows):
            for j in range(max(0, -cols), spec.cols - max(0, cols)):
                yield (
                    f'<spatial stiffness="{spring}" springlength="{length}" damping="{spec.damping}" '
                    f'group="{_HIDDEN}" {range_}>'
                    f'<site site="{_mass(i, j)}"/><site site="{_mass(i + rows, j + cols)}"/></spatial>'
                )


def _skin(spec: SheetSpec) -> str:
    """The fine surface, each of its vertices on the up to four masses around it; twice, to be seen from both sides.

    The cameras put the vertices where `SheetMesh` has them, which is smooth; MuJoCo's own viewer, by the masses. A
    texture covers it once, white as long as nothing is printed on it.
    """
    grid = spec.grid
    weights, rest = grid.straight, _rest(spec)
    vertices = weights.reshape(-1, grid.rows * grid.cols) @ rest
    bones = []
    for j in range(spec.cols):
        for i in range(spec.rows):
            weight = weights[:, :, i, j].ravel()
            touched = np.flatnonzero(weight > 1e-9)
            ids = _numbers([*touched, *(touched + len(vertices))])
            bones.append(
                f'<bone body="{_mass(i, j)}" bindpos="{_numbers(rest[i * spec.cols + j])}" bindquat="1 0 0 0" '
                f'vertid="{ids}" vertweight="{_numbers(np.tile(weight[touched], 2))}"/>'
            )
    faces = np.concatenate([grid.faces, grid.faces[:, ::-1] + len(vertices)])
    return (
        f'<skin name="{SKIN}" rgba="{_numbers(spec.rgba)}" material="{SKIN}" '
        f'vertex="{_numbers(np.tile(vertices, (2, 1)).ravel())}" '
        f'texcoord="{_numbers(np.tile(grid.places, (2, 1)).ravel())}" '
        f'face="{_numbers(faces.ravel())}">{"".join(bones)}</skin>'
    )


def _rest(spec: SheetSpec) -> np.ndarray:
    """(rows * cols, 3) where the masses are before anything moves, row by row."""
    x, y = np.linspace(-0.5, 0.5, spec.cols) * spec.width, np.linspace(0.5, -0.5, spec.rows) * spec.depth
    return np.stack([*np.meshgrid(x, y), np.full((spec.rows, spec.cols), spec.lift)], axis=-1).reshape(-1, 3)


def _numbers(values: Iterable[Any]) -> str:
    return " ".join(map(str, values))
