"""A sheet: the physics of a cloth that lies on a table and is held at two neighbouring corners.

The sheet consists of point masses on slides in a grid, connected by tendons, which are springs that also resist
compression. Those along the grid do not stretch beyond their length; those across its cells (shear) and over every
second mass (bending) do. A sheet that is pushed therefore buckles. The table is a lower limit of the masses' heights;
its friction is a damping that decreases with speed, so that the force is nearly the same at all speeds. The motion of
the two corners is prescribed. Contacts are off.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies import GRIPPERS, Body, MaterialFactors
from shape_obs_envs.mujoco.bodies.sheet_mesh import SKIN, SheetGrid, SheetMesh
from shape_obs_envs.mujoco.scene import mujoco

#: Texels of the texture, down and across.
PRINT = 64, 128
_HIDDEN = 4  # a group that is not rendered
_HEAVY = 1.0  # mass of a corner: its prescribed motion must not be affected by the sheet's forces

Array = NDArray[np.float64]

_CLEAR = 0.004  # height in metres above which a mass has no friction on the table


@dataclass(frozen=True)
class SheetSpec:
    """Size and material of the sheet. Row 0 is the held edge, column 0 the side of gripper 0; lengths are in metres.

    Attributes:
        width: Length of the held edge.
        depth: Length of the two sides.
        rows: Number of masses from the held edge to the free one.
        cols: Number of masses along the held edge.
        subdivision: Number of fine steps of the rendered surface from mass to mass.
        lift: Height of the sheet's surface above the table.
        mass: Each mass in kg.
        gravity: Gravity in m/s2; less than on Earth, so that the load on the two held corners stays small.
        stretch: Stiffness in N/m along the grid, within the limit.
        shear: Stiffness in N/m of the cells' diagonals.
        bending: Stiffness in N/m over every second mass.
        damping: Damping of each tendon in N s/m.
        drag: Drag of the air on each mass in N s/m.
        friction: Coefficient of friction on the table.
        creep: Speed in m/s at which friction reaches half its value; masses on the table that are pulled less than that
            move slower.
        timestep: Timestep of the physics in seconds.
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
        """The grid of the masses and of the surface through them."""
        return SheetGrid(self.rows, self.cols, self.subdivision, self.lift)


def sheet_bodies(spec: SheetSpec) -> str:
    """Return MJCF of the masses, flat about the world's origin with the held edge at +y, and of the two grippers."""
    rest = _rest(spec)
    table = f'range="0 1" {_limit(spec)}'
    parts = []
    # Column by column: the bandwidth of the solver's matrices is the number of masses in a column.
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
    """Return MJCF of the solver settings, the tendons and the skin: top-level sections."""
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
    """Return the number of tendons that resist bending; they are the last ones."""
    return spec.rows * (spec.cols - 2) + (spec.rows - 2) * spec.cols


def _limit(spec: SheetSpec) -> str:
    """Return attributes of a limit twice as stiff as MuJoCo's stiffest time constant: two corners carry the load."""
    stiffness, damping = 0.5 / spec.timestep**2, 1 / spec.timestep
    return f'limited="true" solreflimit="-{stiffness} -{damping}" solimplimit=".95 .99 .001"'


def _mass(row: int, col: int) -> str:
    return f"mass{row}_{col}"


def _jaw() -> str:
    """Return MJCF of the visible gripper: a box beyond the held edge, outside the sheet's plane and not above it.

    y points away from the sheet along the table. The gap is as wide as the box is deep, so the box does not occlude the
    sheet for a camera on the sheet's side within 45 degrees of the vertical, unless the sheet is folded over that edge.
    """
    return '<geom type="box" size=".009 .012 .003" pos="0 .019 -.004" rgba=".2 .2 .2 1"/>'


def _tendons(spec: SheetSpec) -> Iterator[str]:
    across, down = spec.width / (spec.cols - 1), spec.depth / (spec.rows - 1)
    # offset (rows, cols), stiffness, whether its length is limited
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
    """Return MJCF of the fine surface, with each vertex bound to the masses around it; twice, for both sides.

    The cameras move the vertices to the smooth positions of ``SheetMesh``; MuJoCo's viewer interpolates the masses. A
    texture covers the surface once; it is white by default.
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
    """Return the initial positions ``(rows * cols, 3)`` of the masses, row by row."""
    x, y = np.linspace(-0.5, 0.5, spec.cols) * spec.width, np.linspace(0.5, -0.5, spec.rows) * spec.depth
    return np.stack([*np.meshgrid(x, y), np.full((spec.rows, spec.cols), spec.lift)], axis=-1).reshape(-1, 3)


def _numbers(values: Iterable[Any]) -> str:
    return " ".join(map(str, values))


class Sheet(Body):
    """The sheet in a compiled model: poses, surface, state and stepping. A gripper's pose is x, y, z in metres.

    Args:
        spec: Nominal size and material, from which the model was compiled.
        model: The compiled model.

    Attributes:
        nominal: Nominal size and material.
        spec: Size and present material.
        mesh: The surface, for points and for rendering.
    """

    def __init__(self, spec: SheetSpec, model: Any) -> None:
        super().__init__(model, GRIPPERS)
        self.nominal = self.spec = spec
        self.mesh = SheetMesh(model)
        bodies = [model.body(f"mass{i}_{j}").id for j in range(spec.cols) for i in range(spec.rows)]
        self._rest = model.body_pos[bodies].copy()
        self._dofs = np.arange(3 * len(bodies)).reshape(-1, 3)
        self._held = np.array([0, len(bodies) - spec.rows])

    # ---- Body

    def gripper_poses(self) -> Array:
        """Return the positions ``(2, 3)`` of the held corners in metres, world frame."""
        return self.data.qpos[self._dofs[self._held]] + self._rest[self._held]

    def gripper_targets(self) -> Array:
        """Return the positions ``(2, 3)`` of the mocap bodies in metres, world frame."""
        return self.data.mocap_pos[self._grippers]

    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to ``poses`` ``(2, 3)``, rotated with the line between them."""
        way = poses[1] - poses[0]
        half = np.arctan2(way[1], way[0]) / 2
        self.data.mocap_pos[self._grippers] = poses
        self.data.mocap_quat[self._grippers] = np.cos(half), 0.0, 0.0, np.sin(half)

    def advance(self, poses: Array) -> None:
        """Move the grippers to ``poses`` and advance the physics by one step; ``refresh`` must follow."""
        self.set_grippers(poses)
        self._move_corners()
        self._set_friction()
        mujoco.mj_step(self.model, self.data)

    @property
    def colour(self) -> tuple[float, float, float]:
        """Nominal red, green and blue, 0 ... 1."""
        return self.nominal.rgba[:3]

    @property
    def tone_shape(self) -> tuple[int, int]:
        """Texels of its texture, down from the held edge and across from gripper 0's side."""
        return PRINT

    @property
    def underlay(self) -> float:
        """Half the height of its surface, in metres."""
        return self.spec.lift / 2

    def landmarks(self) -> Array:
        """Return points ``(16, 3)`` at and near the four corners, in metres, world frame."""
        near = np.array([0.0, 0.12, 0.88, 1.0])
        return self.points(near, near).reshape(-1, 3)

    def set_colours(self, rgb: Sequence[float], tones: NDArray[Any]) -> None:
        """Set its colour to ``rgb``, 0 ... 1, times the factors ``tones`` ``(64, 128)``, at most 1."""
        model = self.model
        model.skin_rgba[model.skin(SKIN).id, :3] = rgb
        start = int(model.tex_adr[model.texture(SKIN).id])
        texels = np.repeat(np.rint(255 * np.clip(tones, 0, 1)).astype(np.uint8), 3)
        model.tex_data[start : start + texels.size] = texels

    def set_material(self, factors: MaterialFactors) -> None:
        """Change its material; it must be placed again after that. The thickness is ignored."""
        model, nominal = self.model, self.nominal
        self.spec = replace(
            nominal,
            bending=nominal.bending * factors.stiffness,
            damping=nominal.damping * factors.damping,
            friction=nominal.friction * factors.friction,
        )
        model.tendon_stiffness[-bending_tendons(nominal) :] = self.spec.bending
        model.tendon_damping[:] = self.spec.damping

    # ---- shape

    def lay(self, middle: Array, turn: float) -> None:
        """Place the sheet flat and at rest.

        Args:
            middle: Middle of the held edge, x and y in metres.
            turn: Heading of the held edge from corner 0 to corner 1 in radians.
        """
        mujoco.mj_resetData(self.model, self.data)
        along = np.array([np.cos(turn), np.sin(turn)])
        flat = self._rest[:, :2] - (0.0, self.spec.depth / 2)
        at = middle + flat[:, :1] * along + flat[:, 1:] * (-along[1], along[0])
        self.data.qpos[self._dofs[:, :2]] = at - self._rest[:, :2]
        self.refresh()
        self.set_grippers(self.gripper_poses())

    def vertices(self) -> Array:
        """Return the surface's fine vertices ``(fine rows, fine cols, 3)`` in metres, world frame."""
        return self.mesh.vertices(self.data)

    def points(self, down: Array, across: Array) -> Array:
        """Return points ``(R, C, 3)`` of the surface in metres, world frame; see ``SheetMesh.points``."""
        return self.mesh.points(self.vertices(), down, across)

    def stretch(self) -> float:
        """Return the largest strain of an edge between neighbouring masses; 0.05 is 5 % longer than at rest."""
        masses = self.mesh.masses(self.data)
        sides = (self.spec.depth / (self.spec.rows - 1), self.spec.width / (self.spec.cols - 1))
        lengths = [np.linalg.norm(np.diff(masses, axis=axis), axis=-1).max() for axis in (0, 1)]
        return max(float(length / side) - 1 for length, side in zip(lengths, sides, strict=True))

    def slack(self) -> Array:
        """Return how much nearer each held corner is to its free corner than the side's length, ``(2,)``, in metres."""
        masses = self.mesh.masses(self.data)
        sides = masses[0, [0, -1], :2] - masses[-1, [0, -1], :2]
        return np.maximum(self.spec.depth - np.linalg.norm(sides, axis=1), 0.0)

    # ---- internal

    def _move_corners(self) -> None:
        """Set the velocities of the two corners so that they reach the grippers in one timestep."""
        dofs = self._dofs[self._held]
        away = self.gripper_targets() - self.gripper_poses()
        self.data.qvel[dofs] = away / self.spec.timestep

    def _set_friction(self) -> None:
        """Set the horizontal damping: drag of the air, and friction of the masses on the table."""
        spec = self.spec
        velocity = self.data.qvel[self._dofs[:, :2]]
        speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
        lying = np.clip(1 - self.data.qpos[self._dofs[:, 2]] / _CLEAR, 0.0, 1.0)
        friction = spec.friction * spec.mass * spec.gravity * lying / (speed + spec.creep)
        self.model.dof_damping[self._dofs[:, :2]] = spec.drag + friction[:, None]
