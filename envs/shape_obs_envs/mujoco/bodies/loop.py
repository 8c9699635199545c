"""A planar loop of links: the physics of a flat elastic band that lies on a table and is held at two opposite points.

The band is inextensible (rigid links, closed by a constraint) and springs back into a circle. The drag of a viscous
medium models the friction of the table. Gravity and contacts are off. The band is flat, so that the outline seen by a
camera is an edge of known height.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs.geometry.polyline import resample
from shape_obs_envs.mujoco.bodies import GRIPPERS, OBJECT_GROUP, MaterialFactors, PlanarBody
from shape_obs_envs.mujoco.bodies.tube import Station, Tube, reshape_tube, set_tube_colours, tube_skin
from shape_obs_envs.mujoco.scene import mujoco

Array = NDArray[np.float64]

_OFFSET = 2e-5  # metres


@dataclass(frozen=True)
class LoopSpec:
    """Size and material of the band.

    Attributes:
        length: Circumference along the middle of the band in metres.
        width: Width from inside to outside in metres.
        thickness: Height in metres.
        links: Number of rigid links; even, so that one is opposite to the first.
        stiffness: Bending stiffness in N m / rad.
        damping: Bending damping in N m s / rad.
        rgba: Colour.
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
        """Distance of neighbouring hinges in metres."""
        return self.length / self.links

    @property
    def turn(self) -> float:
        """Angle between neighbouring links of the circle in radians; negative is clockwise, seen from above."""
        return -2 * np.pi / self.links

    @property
    def held(self) -> tuple[int, int]:
        """Indices of the links that the grippers hold at their middle."""
        return 0, self.links // 2


def loop_bodies(spec: LoopSpec) -> str:
    """Return MJCF of the band, cut open between its last and first link and straight along x, with its grippers."""
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
        if i == spec.links:  # an invisible copy of the first link: welding both closes the band
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
    """Return MJCF of the skin that OpenGL draws instead of the geoms; it starts and ends in the middle of link 0."""
    return tube_skin(_tube(spec), spec.links, spec.rgba)


def _tube(spec: LoopSpec) -> Tube:
    link, half = spec.link_length, (spec.width / 2, spec.thickness / 2)
    joints = [Station(link * i, 1.0, (i - 1, i)) for i in range(1, spec.links + 1)]
    stations = [Station(link / 2, 1.0, (0,)), *joints, Station(link * (spec.links + 0.5), 1.0, (spec.links,))]
    corners = np.array([[1, -1], [1, 1], [1, 1], [-1, 1], [-1, 1], [-1, -1], [-1, -1], [1, -1]]) * half
    return Tube(stations, corners, spec.thickness / 2, link, np.zeros(2))


def loop_equality(spec: LoopSpec) -> str:
    """Return MJCF of the constraints that close the band and weld it to its grippers.

    They are between sites: constraints between bodies would keep the band's initial, open configuration.
    """
    pairs = [(gripper, f"held{link}", ".95 .99 .001") for gripper, link in zip(GRIPPERS, spec.held, strict=True)]
    # The closing constraint is stiffer than the grippers' welds.
    pairs.append(("first", "last", ".999 .9999 .001"))
    return "\n".join(f'<weld site1="{a}" site2="{b}" solref=".02 1" solimp="{solimp}"/>' for a, b, solimp in pairs)


def _jaw(spec: LoopSpec) -> str:
    """Return MJCF of the visible gripper: a jaw next to the outer edge, lower than the band, so as not to hide it."""
    size, place = (" ".join(map(str, part)) for part in _jaw_box(spec))
    return f'<geom type="box" mass="0" rgba=".2 .2 .2 1" size="{size}" pos="{place}"/>'


def _jaw_box(spec: LoopSpec) -> tuple[Sequence[float], Sequence[float]]:
    """Return half size and place ``(3,)`` in metres of a jaw on its link."""
    depth, gap, half = 0.02, 0.002, 0.4 * spec.thickness
    place = spec.link_length / 2, spec.width / 2 + gap + depth / 2, half - spec.thickness / 2
    return (0.012, depth / 2, half), place


class Loop(PlanarBody):
    """The band in a compiled model: poses, outline and stepping.

    A gripper's pose is its point (x, y) of the middle line in metres and the turn of the band there in radians, 0 if
    the undisturbed band has gripper 0 on its left.

    Args:
        spec: Nominal size and material, from which the model was compiled.
        model: The compiled model.

    Attributes:
        nominal: Nominal size and material.
        spec: Size with the present width and thickness.
    """

    def __init__(self, spec: LoopSpec, model: Any) -> None:
        super().__init__(model, GRIPPERS)
        self.nominal = self.spec = spec
        self._bodies = np.array([model.body(f"link{i}").id for i in range(spec.links)])
        self._pieces = np.array([model.geom(f"link{i}").id for i in range(spec.links)])
        self._knuckles = np.array([model.geom(f"knuckle{i}").id for i in range(spec.links)])
        # Converts headings of the held links to turns.
        self._rest = np.pi / 2 + spec.turn * np.array(spec.held)

    @property
    def colour(self) -> tuple[float, float, float]:
        """Nominal red, green and blue, 0 ... 1."""
        return self.nominal.rgba[:3]

    @property
    def tone_shape(self) -> tuple[int, int]:
        """One tone per link."""
        return self.spec.links, 1

    @property
    def underlay(self) -> float:
        """A quarter of its thickness, in metres."""
        return 0.25 * self.spec.thickness

    def landmarks(self) -> Array:
        """Return points ``(4 links, 3)`` on the band's top, a third of its width from the outer edge, in metres.

        If they are visible, the band looks closed even in a small image.
        """
        joints, spec = self.axis(), self.spec
        along = np.roll(joints, -1, axis=0) - joints
        outward = np.column_stack([-along[:, 1], along[:, 0], np.zeros(len(along))]) / spec.link_length
        points = [joints + part * along + spec.width / 6 * outward for part in (0.0, 0.25, 0.5, 0.75)]
        return np.concatenate(points) + (0, 0, spec.thickness / 2)

    def set_colours(self, rgb: Sequence[float], tones: NDArray[Any]) -> None:
        """Set its colour to ``rgb``, 0 ... 1, times a factor in ``tones`` ``(links, 1)`` for each link."""
        colours = tones * rgb
        self.model.geom_rgba[self._pieces, :3] = colours
        self.model.geom_rgba[self._knuckles, :3] = (colours + np.roll(colours, 1, axis=0)) / 2
        # The knuckles lie slightly lower: at equal height it would be undefined which of two tones is visible.
        self.model.geom_size[self._knuckles, 1] = self.spec.thickness / 2 - _OFFSET
        set_tube_colours(self.model, rgb, tones[:, 0])

    def set_material(self, factors: MaterialFactors) -> None:
        """Change its material; it must be placed again after that. Mass and inertia stay the same."""
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
        self._set_bending(slice(3, 3 + spec.links), nominal.stiffness, nominal.damping, factors)

    def place(self, middle: Array, turn: float) -> None:
        """Place the band at rest as a circle about ``middle`` (x, y), turned by ``turn``."""
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
        """Return the measured poses ``(2, 3)`` of the held points: x, y in metres and turn in radians, world frame."""
        headings = np.array([self.data.qpos[2 : 3 + link].sum() for link in self.spec.held])
        axis = self.axis()
        middles = [(axis[link] + axis[(link + 1) % self.spec.links]) / 2 for link in self.spec.held]
        return np.column_stack([np.array(middles)[:, :2], headings - self._rest])

    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to ``poses`` ``(2, 3)``: x, y in metres and turn in radians, world frame."""
        super().set_grippers(poses + np.column_stack([np.zeros((2, 2)), self._rest]))

    def gripper_targets(self) -> Array:
        """Return the poses ``(2, 3)`` of the mocap bodies: x, y in metres and turn in radians, world frame."""
        poses = super().gripper_targets()
        poses[:, 2] = (poses[:, 2] - self._rest + np.pi) % (2 * np.pi) - np.pi
        return poses

    def axis(self) -> Array:
        """Return the hinges ``(links, 3)`` in the middle of the band, clockwise from link 0, in metres, world frame."""
        return self.data.xpos[self._bodies].copy()

    def outline(self) -> Array:
        """Return the upper outer edge as a closed polyline ``(V, 3)``, clockwise from gripper 0, in metres."""
        joints, spec = self.axis()[:, :2], self.spec
        along = np.roll(joints, -1, axis=0) - joints
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        normals = np.column_stack([-along[:, 1], along[:, 0]]) * (
            spec.width / 2
        )  # clockwise: the outside is on the left
        before = np.roll(normals, 1, axis=0)
        between = before + normals
        between /= np.linalg.norm(between, axis=1, keepdims=True)
        # Round at a protruding knuckle, a corner where the links overlap.
        convex = (before[:, 0] * normals[:, 1] - before[:, 1] * normals[:, 0])[:, None] < 0
        rounded = between * (spec.width / 2)
        corner = between * ((spec.width / 2) ** 2 / (between * normals).sum(axis=1, keepdims=True))
        places = [np.where(convex, offset, corner) for offset in (before, rounded, normals)]
        edge = (joints[:, None] + np.stack(places, axis=1)).reshape(-1, 2)
        start = (joints[0] + joints[1]) / 2 + normals[0]
        edge = np.concatenate([start[None], np.roll(edge, -3, axis=0)])
        return np.column_stack([edge, np.full(len(edge), spec.thickness)])

    def points(self, n: int) -> Array:
        """Return points ``(n, 3)`` of the outline, equidistant along it from gripper 0, in metres, world frame."""
        edge = self.outline()
        return resample(np.concatenate([edge, edge[:1]]), n + 1)[:-1]

    def held_points(self) -> Array:
        """Return the points ``(2, 3)`` of the upper outer edge where the grippers hold it, in metres, world frame."""
        poses = self.gripper_poses()
        heading = poses[:, 2] + self._rest
        outward = np.column_stack([-np.sin(heading), np.cos(heading)])
        edge = poses[:, :2] + outward * (self.spec.width / 2)
        return np.column_stack([edge, np.full(2, self.spec.thickness)])
