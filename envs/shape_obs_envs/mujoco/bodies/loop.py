"""A planar loop of links: the physics of a flat elastic band that lies on a table and is held at two opposite places.

The band is inextensible (rigid links, closed by a constraint), springs back into a circle, and is dragged by a viscous
medium that stands in for the friction of the table. Gravity and contacts are off. It is flat, so that the outline that
a camera sees is an edge whose height is known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies.base import GRIPPERS, OBJECT_GROUP, PlanarBody
from shape_obs_envs.mujoco.engine import mujoco

Array = NDArray[np.float64]


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
    depth, gap, half = 0.02, 0.002, 0.4 * spec.thickness
    return (
        f'<geom type="box" mass="0" rgba=".2 .2 .2 1" size="0.012 {depth / 2} {half}" '
        f'pos="{spec.link_length / 2} {spec.width / 2 + gap + depth / 2} {half - spec.thickness / 2}"/>'
    )


class Loop(PlanarBody):
    """The band inside a compiled model: poses, outline and stepping.

    A gripper's pose is the place of its point of the middle line (x, y) [m] and the turn of the band there [rad],
    0 where the undisturbed band has gripper 0 on its left.

    Args:
        spec: What the model was written from.
        model: The compiled model.
    """

    def __init__(self, spec: LoopSpec, model: Any) -> None:
        super().__init__(model, GRIPPERS)
        self.spec = spec
        self._bodies = np.array([model.body(f"link{i}").id for i in range(spec.links)])
        # From the circle's headings at the held links to turns.
        self._rest = np.pi / 2 + spec.turn * np.array(spec.held)

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
