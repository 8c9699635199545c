"""Several ropes that lie over each other in a compiled model: poses, state, stepping and true shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies import GRIPPERS, MaterialFactors, PlanarBody
from shape_obs_envs.mujoco.bodies.chain import ChainSpec, arc_lengths, jaw_boxes
from shape_obs_envs.mujoco.bodies.ropes_model import VERTICAL, holder, rope_tube
from shape_obs_envs.mujoco.bodies.tube import reshape_tube, set_tube_colours
from shape_obs_envs.mujoco.scene import mujoco

Array = NDArray[np.float64]

#: Largest force of a gripper in newtons; drag and contacts of ropes that are not taut ask for less than 3 N.
STRONGEST: Final = 5.0


class Ropes(PlanarBody):
    """Ropes in a compiled model: poses, state and stepping.

    Args:
        spec: Nominal size and material of each rope, from which the model was compiled.
        ropes: Number of ropes.
        model: The compiled model.

    Attributes:
        nominal: Nominal size and material.
        spec: Size with the present radius.
        ropes: Number of ropes.
        marked: Numbers of the ropes whose ends are landmarks.
        arc: Arc lengths ``(links + 1,)`` in metres from end 0 to each vertex.
    """

    def __init__(self, spec: ChainSpec, ropes: int, model: Any) -> None:
        super().__init__(model, GRIPPERS[: spec.grippers])
        self.nominal, self.spec, self.ropes = spec, spec, ropes
        self.marked: Sequence[int] = range(ropes)
        names = [[f"rope{rope}_link{i}" for i in range(spec.links)] for rope in range(ropes)]
        self._bodies = np.array([[model.body(name).id for name in row] for row in names])
        self._geoms = np.array([[model.geom(name).id for name in row] for row in names])
        holders = [[holder(rope, spec.grippers), f"rope{rope}_socket"] for rope in range(ropes)]
        self._ends = np.array([[int(model.body(name).mocapid[0]) for name in row] for row in holders])
        self._end_bodies = np.array([[model.body(name).id for name in row] for row in holders])
        self.arc = arc_lengths(spec)
        yaw = int(model.joint("rope0_yaw1").id)
        self._yaws = yaw + 2 * np.arange(ropes * (spec.links - 1))

    # ---- poses

    def set_grippers(self, poses: Array) -> None:
        """Move the grippers to ``poses`` ``(G, 3)``: x, y in metres and heading from end 0 to end 1 in radians."""
        self._set_ends(self._grippers, poses)

    def gripper_targets(self) -> Array:
        """Return the poses ``(G, 3)`` of the grippers, as last set by ``set_grippers``."""
        poses = super().gripper_targets()
        poses[:, 2] = _wrapped(poses[:, 2] - np.pi)
        return poses

    def gripper_poses(self) -> Array:
        """Return the poses ``(G, 3)`` of the held tips: x, y in metres and heading in radians, world frame."""
        return self.end_poses()[: self.spec.grippers, 0]

    def end_poses(self) -> Array:
        """Return the poses ``(K, 2, 3)`` of all tips, end 0 first: x, y in metres and heading in radians."""
        along = -self.data.xmat[self._bodies[:, [-1, 0]]].reshape(-1, 2, 3, 3)[..., 0]
        heading = np.arctan2(along[..., 1], along[..., 0])
        return np.concatenate([self.vertices()[:, [0, -1], :2], heading[..., None]], axis=2)

    def pull_to(self, start: Array, target: Array, substeps: int) -> Array:
        """Move the grippers as ``step_to`` does; return the poses ``(G, 3)`` at which they stop.

        A gripper that has to pull with more than ``STRONGEST`` stops where it is until the end of the motion: its rope
        is taut around another one, and both would be pressed into each other and into the table.
        """
        held = np.zeros(len(start), bool)
        reached = start
        for i in range(1, substeps + 1):
            reached = np.where(held[:, None], reached, start + (target - start) * (i / substeps))
            self.advance(reached)
            # The welds are the first constraints, three forces and three torques each, ropes with grippers first.
            force = self.data.efc_force[: 6 * len(start)].reshape(-1, 6)[:, :3]
            strained = ~held & (np.linalg.norm(force, axis=1) > STRONGEST)
            reached = np.where(strained[:, None], self.gripper_poses(), reached)
            held |= strained
        self.refresh()
        return reached

    def set_state(self, state: Array) -> None:
        """Restore a result of ``get_state``, with all ends at the height of the present thickness."""
        super().set_state(state)
        self.data.mocap_pos[self._ends, 2] = self.spec.radius
        self.refresh()

    def _set_ends(self, mocap: NDArray[Any], poses: Array) -> None:
        """Move mocap bodies ``(M,)`` to ``poses`` ``(M, 3)``; the links' x axes run from end 1 to end 0."""
        self.data.mocap_pos[mocap, :2] = poses[:, :2]
        self.data.mocap_pos[mocap, 2] = self.spec.radius
        half = (poses[:, 2] + np.pi) / 2
        self.data.mocap_quat[mocap] = np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])

    def place(self, lines: Array) -> None:
        """Place the ropes at rest along polylines ``(K, links + 1, 3)`` in metres from end 0; ends must be level."""
        mujoco.mj_resetData(self.model, self.data)
        ways = np.diff(lines[:, ::-1], axis=1)  # from end 1
        ways /= np.linalg.norm(ways, axis=2)[..., None]
        heading = np.arctan2(-ways[:, 0, 1], -ways[:, 0, 0])
        self._set_ends(self._ends[:, 1], np.column_stack([lines[:, -1, :2], heading]))
        self.data.qpos[:] = np.concatenate([hinge_angles(way).ravel() for way in ways])
        self.refresh()
        self._set_ends(self._ends[:, 0], self.end_poses()[:, 0])

    # ---- the true shape

    def vertices(self) -> Array:
        """Return the axes as polylines ``(K, links + 1, 3)`` from end 0 to end 1, in metres, world frame."""
        joints = self.data.xpos[self._bodies]
        along = self.data.xmat[self._bodies[:, [0, -1]]].reshape(-1, 2, 3, 3)[..., 0]
        first = joints[:, :1] - self.spec.radius * along[:, :1]
        last = joints[:, -1:] + (self.spec.link_length + self.spec.radius) * along[:, 1:]
        return np.concatenate([first, joints[:, 1:], last], axis=1)[:, ::-1]

    def points(self, fractions: Array) -> Array:
        """Return points ``(K, n, 3)`` of the axes at ``fractions`` ``(n,)`` of their length, in metres, world frame."""
        arc = np.clip(fractions, 0.0, 1.0) * self.spec.length
        i = np.clip(np.searchsorted(self.arc, arc, side="right") - 1, 0, self.spec.links - 1)
        t = ((arc - self.arc[i]) / (self.arc[i + 1] - self.arc[i]))[:, None]
        vertices = self.vertices()
        return vertices[:, i] * (1 - t) + vertices[:, i + 1] * t

    def fractions(self, places: Array) -> Array:
        """Return fractions 0 ... 1 of the length for ``places`` in segments of ``vertices``."""
        return np.interp(places, np.arange(len(self.arc)), self.arc) / self.spec.length

    def landmarks(self) -> Array:
        """Return points ``(n, 3)`` on the first and last tenth of the ``marked`` axes, in metres, world frame."""
        points = self.points(np.concatenate([np.linspace(0.0, 0.1, 10), np.linspace(0.9, 1.0, 10)]))
        return points[list(self.marked)].reshape(-1, 3)

    # ---- appearance and material

    @property
    def colour(self) -> tuple[float, float, float]:
        """Nominal red, green and blue of all ropes, 0 ... 1."""
        return self.nominal.rgba[:3]

    @property
    def tone_shape(self) -> tuple[int, int]:
        """One tone per link, rope by rope."""
        return self.ropes * self.spec.links, 1

    @property
    def underlay(self) -> float:
        """Zero: ropes that lie on the table have contacts with it, and none with what lies there."""
        return 0.0

    def set_colours(self, rgb: Sequence[float], tones: NDArray[Any]) -> None:
        """Set the colour of all ropes to ``rgb``, 0 ... 1, times a factor in ``tones`` for each link."""
        self.model.geom_rgba[self._geoms.ravel(), :3] = tones * rgb
        for rope, own in enumerate(tones[:, 0].reshape(self.ropes, -1)):
            set_tube_colours(self.model, rgb, own, f"rope{rope}_")

    def set_material(self, factors: MaterialFactors) -> None:
        """Change their material; they must be placed again after that. Mass and inertia stay the same."""
        model, nominal = self.model, self.nominal
        self.spec = spec = replace(nominal, radius=nominal.radius * factors.thickness)
        self.arc = arc_lengths(spec)
        radius, link, bodies, geoms = spec.radius, spec.link_length, self._bodies, self._geoms
        model.body_pos[bodies[:, 1:], 0], model.body_pos[bodies[:, 0], 0] = link, radius
        model.geom_size[geoms, :2] = radius, link / 2
        model.geom_rbound[geoms] = radius + link / 2
        model.geom_pos[geoms, 0] = model.body_ipos[bodies, 0] = link / 2
        feet = geoms + 1
        model.geom_size[feet, 0] = model.geom_rbound[feet] = radius
        model.geom_pos[feet, 0] = link
        for end, tip, sign in ((0, -radius, -1), (-1, link + radius, 1)):
            for i, (size, place) in enumerate(jaw_boxes(radius, tip, sign)):
                jaw = feet[:, end] + 1 + i
                model.geom_size[jaw], model.geom_pos[jaw] = size, place
                model.geom_rbound[jaw] = np.linalg.norm(size)
        model.eq_data[: self.ropes, 3] = -link - radius  # position of the link relative to what holds it
        model.body_pos[self._end_bodies, 2] = radius
        for rope in range(self.ropes):
            reshape_tube(model, rope_tube(spec, rope), f"rope{rope}_")
        first = int(self._yaws[0]) - 1
        joints = slice(first, first + 2 * len(self._yaws))
        self._set_bending(joints, nominal.stiffness, nominal.damping, factors)
        model.jnt_stiffness[self._yaws - 1] = VERTICAL * factors.stiffness


def hinge_angles(ways: Array) -> Array:
    """Return pitch and yaw ``(links - 1, 2)`` in radians of the joints of a chain along unit vectors ``(links, 3)``.

    The first link is level and cannot turn. A joint turns the next link by its pitch about y, then by its yaw about z.
    """
    sine, cosine = ways[0, 1], ways[0, 0]
    frame = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    out = np.empty((len(ways) - 1, 2))
    for i, way in enumerate(ways[1:]):
        x, y, z = way @ frame
        out[i] = pitch, yaw = np.arctan2(-z, x), np.arcsin(np.clip(y, -1, 1))
        (cp, sp), (cy, sy) = (np.cos(pitch), np.sin(pitch)), (np.cos(yaw), np.sin(yaw))
        frame = frame @ np.array([[cp * cy, -cp * sy, sp], [sy, cy, 0.0], [-sp * cy, sp * sy, cp]])
    return out


def _wrapped(angle: Array) -> Array:
    """Return angles within -pi ... pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
