"""A planar loop of links: the physics of a flat elastic band that lies on a table and is held at two opposite places.

The band is inextensible (rigid links, closed by a constraint), springs back into a circle, and is dragged by a viscous
medium that stands in for the friction of the table. Gravity and contacts are off. It is flat, so that the outline that
a camera sees is an edge whose height is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies.base import GRIPPERS, OBJECT_GROUP, MaterialFactors, PlanarBody
from shape_obs_envs.mujoco.bodies.tube import Station, Tube, print_tube, reshape_tube, tube_skin
from shape_obs_envs.mujoco.engine import mujoco

Array = NDArray[np.float64]

_HAIR = 2e-5  # [m]


@dataclass(frozen=True)
class LoopSpec:
    """Size and material of the band.

    Attributes:
        length: Once around, along the middle of the band [m].
        width: Of the band, from inside to outside [m].
        thickness: How high it lies [m].
        links: How many rigid pieces; even, so that there is one opposite to the first.
        stiffness: Of a bend [N m / rad].
        damping: Of a bend [N m s / rad].
        rgba: Its colour.
    """

    length: float = 0.8
    width: float = 0.022
    thickness: float = 0.004
    links: int = 36
    stiffness: float = 0.01
    damping: float = 5e-5
    rgba: tuple[float, float, float, float] = (0.05, 0.25, 0.95, 1.0)

    @property
    def link_length(self) -> float:
        """Distance of two neighbouring hinges [m]."""
        return self.length / self.links

    @property
    def turn(self) -> float:
        """Angle between neighbouring links of the circle [rad]; negative is clockwise, seen from above."""
        return -2 * np.pi / self.links

    @property
    def held(self) -> tuple[int, int]:
        """The links that the grippers hold, by their middle."""
        return 0, self.links // 2


def loop_bodies(spec: LoopSpec) -> str:
    """MJCF of the band, cut open between its last and first link and straight along x, with its two grippers."""
    link, half = spec.link_length, spec.thickness / 2
    looks = f'group="{OBJECT_GROUP}" rgba="{" ".join(map(str, spec.rgba))}"'
    parts = [f'<body name="link0" pos="0 0 {half}">']
    parts.append('<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>')
    parts.append('<joint name="heading" type="hinge" axis="0 0 1"/><site name="first" group="4"/>')
    for i in range(spec.links + 1):
        if i:
            parts.append(f'<body name="link{i}" pos="{link} 0 0">')
            parts.append(
                f'<joint name="bend{i}" type="hinge" axis="0 0 1" stiffness="{spec.stiffness}" '
                f'springref="{spec.turn}" damping="{spec.damping}" armature="1e-6"/>'
            )
        if i == spec.links:  # the first link once more, unseen: welded to it, it closes the band
            parts.append(f'<geom type="sphere" size="{half}" rgba="0 0 0 0"/><site name="last" group="4"/>')
            break
        parts.append(
            f'<geom name="link{i}" type="box" size="{link / 2} {spec.width / 2} {half}" pos="{link / 2} 0 0" {looks}/>'
            f'<geom name="knuckle{i}" type="cylinder" mass="0" size="{spec.width / 2} {half}" {looks}/>'
        )
        if i in spec.held:
            parts.append(f'<site name="held{i}" group="4" pos="{link / 2} 0 0"/>')
            parts.append(_jaw(spec))
    parts.append("</body>" * (spec.links + 1))
    parts += [f'<body name="{n}" mocap="true" pos="0 0 {half}"><site name="{n}" group="4"/></body>' for n in GRIPPERS]
    return "\n".join(parts)


def loop_skin(spec: LoopSpec) -> str:
    """MJCF of what OpenGL draws instead of boxes and cylinders; it begins and ends in the middle of the first link."""
    return tube_skin(_tube(spec), spec.links, spec.rgba)


def _tube(spec: LoopSpec) -> Tube:
    link, half = spec.link_length, (spec.width / 2, spec.thickness / 2)
    joints = [Station(link * i, 1.0, (i - 1, i)) for i in range(1, spec.links + 1)]
    stations = [Station(link / 2, 1.0, (0,)), *joints, Station(link * (spec.links + 0.5), 1.0, (spec.links,))]
    corners = np.array([[1, -1], [1, 1], [1, 1], [-1, 1], [-1, 1], [-1, -1], [-1, -1], [1, -1]]) * half
    return Tube(stations, corners, spec.thickness / 2, link, np.zeros(2))


def loop_equality(spec: LoopSpec) -> str:
    """MJCF of what closes the band and welds it to its grippers.

    Between sites: what bodies tell of each other before the first step is that the band is cut open.
    """
    pairs = [(gripper, f"held{link}", ".95 .99 .001") for gripper, link in zip(GRIPPERS, spec.held, strict=True)]
    # What holds the band together gives way less than the grippers' hold.
    pairs.append(("first", "last", ".999 .9999 .001"))
    return "\n".join(f'<weld site1="{a}" site2="{b}" solref=".02 1" solimp="{solimp}"/>' for a, b, solimp in pairs)


def _jaw(spec: LoopSpec) -> str:
    """The gripper's looks: a jaw beside the outer edge, lower than the band, so that it never hides the edge."""
    size, place = (" ".join(map(str, part)) for part in _jaw_box(spec))
    return f'<geom type="box" mass="0" rgba=".2 .2 .2 1" size="{size}" pos="{place}"/>'


def _jaw_box(spec: LoopSpec) -> tuple[Sequence[float], Sequence[float]]:
    """Half size and place (3,) [m] of a jaw on its link."""
    depth, gap, half = 0.02, 0.002, 0.4 * spec.thickness
    place = spec.link_length / 2, spec.width / 2 + gap + depth / 2, half - spec.thickness / 2
    return (0.012, depth / 2, half), place


class Loop(PlanarBody):
    """The band inside a compiled model: poses, outline and stepping.

    A gripper's pose is the place of its point of the middle line (x, y) [m] and the turn of the band there [rad],
    0 where the undisturbed band has gripper 0 on its left.

    Args:
        spec: What the model was written from.
        model: The compiled model.

    Attributes:
        nominal: What the model was written from.
        spec: The same with the present width and thickness.
    """

    def __init__(self, spec: LoopSpec, model: Any) -> None:
        super().__init__(model, GRIPPERS)
        self.nominal = self.spec = spec
        self._bodies = np.array([model.body(f"link{i}").id for i in range(spec.links)])
        self._pieces = np.array([model.geom(f"link{i}").id for i in range(spec.links)])
        self._knuckles = np.array([model.geom(f"knuckle{i}").id for i in range(spec.links)])
        self._viscosity = float(model.opt.viscosity)
        # From the circle's headings at the held links to turns.
        self._rest = np.pi / 2 + spec.turn * np.array(spec.held)

    @property
    def colour(self) -> tuple[float, float, float]:
        """Red, green and blue, 0 ... 1, that its model was written with."""
        return self.nominal.rgba[:3]

    @property
    def tone_shape(self) -> tuple[int, int]:
        """A tone for each link."""
        return self.spec.links, 1

    @property
    def underlay(self) -> float:
        """A quarter of its thickness."""
        return 0.25 * self.spec.thickness

    def landmarks(self) -> Array:
        """Points (4 links, 3) [m] on the band's top, a third of its width from the outer edge: it is seen to be closed.

        What is within has to be wide enough for a small picture.
        """
        joints, spec = self.axis(), self.spec
        along = np.roll(joints, -1, axis=0) - joints
        outward = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))]) / spec.link_length
        points = [joints + part * along + spec.width / 6 * outward for part in (0.0, 0.25, 0.5, 0.75)]
        return np.concatenate(points) + (0, 0, spec.thickness / 2)

    def paint(self, rgb: Sequence[float], tones: NDArray[Any]) -> None:
        """Colour it `rgb`, 0 ... 1, with a factor in `tones` (links, 1) for each link."""
        colours = tones * rgb
        self.model.geom_rgba[self._pieces, :3] = colours
        self.model.geom_rgba[self._knuckles, :3] = (colours + np.roll(colours, 1, axis=0)) / 2
        # Which of two tones at one height is seen would be left to chance: the knuckles lie a hair lower.
        self.model.geom_size[self._knuckles, 1] = self.spec.thickness / 2 - _HAIR
        print_tube(self.model, rgb, tones[:, 0])

    def set_material(self, factors: MaterialFactors) -> None:
        """Make it of another material; it is to be placed anew after that. Its mass stays, and with it its inertia."""
        model, nominal = self.model, self.nominal
        width, thickness = nominal.width * factors.thickness, nominal.thickness * factors.thickness
        self.spec = spec = replace(nominal, width=width, thickness=thickness)
        model.geom_size[self._pieces, 1:] = width / 2, thickness / 2
        model.geom_size[self._knuckles, :2] = width / 2, thickness / 2
        model.geom_rbound[self._pieces] = np.linalg.norm([spec.link_length / 2, width / 2, thickness / 2])
        model.geom_rbound[self._knuckles] = np.hypot(width / 2, thickness / 2)
        model.body_pos[self._bodies[0], 2] = model.body_pos[self._held_by, 2] = thickness / 2
        for link in spec.held:
            jaw = self._knuckles[link] + 1
            model.geom_size[jaw], model.geom_pos[jaw] = _jaw_box(spec)
            model.geom_rbound[jaw] = np.linalg.norm(model.geom_size[jaw])
        reshape_tube(model, _tube(spec))
        bends = slice(3, 3 + spec.links)
        model.jnt_stiffness[bends] = nominal.stiffness * factors.stiffness
        model.dof_damping[bends] = nominal.damping * factors.damping
        model.opt.viscosity = self._viscosity * factors.friction

    def place(self, middle: Array, turn: float) -> None:
        """Put the band at rest as a circle about `middle` (x, y) [m], turned by `turn` [rad]."""
        mujoco.mj_resetData(self.model, self.data)
        spec = self.spec
        heading = np.pi / 2 + turn
        along = np.array([np.cos(heading), np.sin(heading)])
        apothem = spec.link_length / 2 / np.tan(np.pi / spec.links)
        outward = np.array([-along[1], along[0]])
        self.data.qpos[:2] = middle + apothem * outward - spec.link_length / 2 * along
        self.data.qpos[2] = heading
        self.data.qpos[3:] = spec.turn
        self.refresh()
        self.set_grippers(self.gripper_poses())

    def gripper_poses(self) -> Array:
        """Where the band is held, as measured: (2, 3) rows of x, y [m] and turn [rad] in the world frame."""
        headings = np.array([self.data.qpos[2 : 3 + link].sum() for link in self.spec.held])
        axis = self.axis()
        middles = [(axis[link] + axis[(link + 1) % self.spec.links]) / 2 for link in self.spec.held]
        return np.column_stack([np.array(middles)[:, :2], headings - self._rest])

    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to `poses` (2, 3): x, y [m] and turn [rad] in the world frame."""
        super().set_grippers(poses + np.column_stack([np.zeros((2, 2)), self._rest]))

    def gripper_targets(self) -> Array:
        """Where the mocap bodies are: (2, 3) of x, y [m] and turn [rad] in the world frame."""
        poses = super().gripper_targets()
        poses[:, 2] = (poses[:, 2] - self._rest + np.pi) % (2 * np.pi) - np.pi
        return poses

    def axis(self) -> Array:
        """The hinges (links, 3) [m] in the middle of the band, clockwise from the start of link 0; world frame."""
        return self.data.xpos[self._bodies].copy()

    def outline(self) -> Array:
        """The upper outer edge as a closed polyline (V, 3) [m], clockwise from gripper 0, not repeated; world frame."""
        joints, spec = self.axis()[:, :2], self.spec
        along = np.roll(joints, -1, axis=0) - joints
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        normals = np.column_stack([-along[:, 1], along[:, 0]]) * (spec.width / 2)  # clockwise: outside is on the left
        before = np.roll(normals, 1, axis=0)
        between = before + normals
        between /= np.linalg.norm(between, axis=1, keepdims=True)
        # Round where the knuckle stands out, a corner where the links overlap.
        convex = (before[:, 0] * normals[:, 1] - before[:, 1] * normals[:, 0])[:, None] < 0
        rounded = between * (spec.width / 2)
        corner = between * ((spec.width / 2) ** 2 / (between * normals).sum(axis=1, keepdims=True))
        places = [np.where(convex, offset, corner) for offset in (before, rounded, normals)]
        edge = (joints[:, None] + np.stack(places, axis=1)).reshape(-1, 2)
        start = (joints[0] + joints[1]) / 2 + normals[0]
        edge = np.concatenate([start[None], np.roll(edge, -3, axis=0)])
        return np.column_stack([edge, np.full(len(edge), spec.thickness)])

    def points(self, n: int) -> Array:
        """(n, 3) [m] points of the outline at equal distances along it, the first at gripper 0; world frame."""
        edge = self.outline()
        closed = np.concatenate([edge, edge[:1]])
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
        at = np.arange(n) / n * arc[-1]
        return np.column_stack([np.interp(at, arc, column) for column in closed.T])

    def held_points(self) -> Array:
        """(2, 3) [m] the points of the upper outer edge where the grippers hold it; world frame."""
        poses = self.gripper_poses()
        heading = poses[:, 2] + self._rest
        outward = np.column_stack([-np.sin(heading), np.cos(heading)])
        edge = poses[:, :2] + outward * (self.spec.width / 2)
        return np.column_stack([edge, np.full(2, self.spec.thickness)])
