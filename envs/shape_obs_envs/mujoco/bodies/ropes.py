"""Several ropes of one colour that lie over each other on a table: chains of capsules in space, with contacts.

Each rope is an inextensible chain of rigid links, which bends at universal joints, two hinges each. End 1 is plugged
into a socket; end 0 is welded to a mocap body, its gripper or a second socket. Gravity lays the ropes on the table and
on each other. The drag of a viscous medium models the friction of the table, as for the planar chain.

Values that hold from MuJoCo 3.3 to 4.0 are below. What each is for:

- ``timestep=".01"``: at 0.3 m/s a strand moves by 3 mm between two solutions of the contacts, a fifth of its thickness,
  and cannot pass through another one. ``integrator="Euler"`` takes 0.6 times as long as ``implicitfast``; it is
  explicit in the drag, which ``viscosity=".5"`` and hinge ``armature="3e-5"`` allow.
- ``gravity="0 0 -30"``: with their own weight, ropes that are stiff enough to take their shape from their ends within a
  second would cross each other in high arcs, and rise when they are compressed. Only the ropes have a weight.
- Hinge stiffness 0.05 N m/rad in the plane and 0.02 vertically, so that a rope lies down next to a crossing. With 0.004
  it buckles upwards, as a strip does that is bent in its plane. Damping 2e-3 N m s/rad.
- Rope on rope: ``condim="3"``, friction 0.1, ``solref=".02 1" solimp=".9 .95 .001"``, one bit of ``contype`` for each
  rope. Links of one rope have no contacts with each other: the limits of the grippers keep it from crossing itself.
- The grippers' force is limited (``Ropes.pull_to``). Otherwise ropes that are jammed at a socket are pressed into each
  other by half of their thickness, and with stiffer contacts (``solimp=".95 .99 .001"``) the simulation explodes.
- Rope on table: a sphere at each joint, ``condim="1"``, as explicit pairs. A capsule has two contacts with a plane, and
  dry friction makes eight rows of them for each link: a step takes half as long again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies import GRIPPERS, OBJECT_GROUP, MaterialFactors, PlanarBody
from shape_obs_envs.mujoco.bodies.chain import ChainSpec, arc_lengths, chain_tube, jaw_boxes, jaws
from shape_obs_envs.mujoco.bodies.tube import Tube, reshape_tube, set_tube_colours, tube_skin
from shape_obs_envs.mujoco.scene import mujoco

_OPTION: Final = (
    '<option integrator="Euler" viscosity=".5" gravity="0 0 -30"><flag contact="enable" gravity="enable"/></option>'
)
#: Vertical bending stiffness in N m / rad.
VERTICAL: Final = 0.02
_ARMATURE: Final = 3e-5
_TOUCH: Final = 'solref=".02 1" solimp=".9 .95 .001"'
_HELD: Final = 'solref=".02 1" solimp=".95 .99 .001"'
_APART: Final = 0.1  # between the ropes in the model's initial configuration, in metres

Array = NDArray[np.float64]

#: Largest force of a gripper in newtons; drag and contacts of ropes that are not taut ask for less than 3 N.
STRONGEST: Final = 5.0


def holder(rope: int, held: int) -> str:
    """Return the name of the mocap body that holds end 0 of a rope."""
    return GRIPPERS[rope] if rope < held else f"rope{rope}_peg"


def ropes_bodies(spec: ChainSpec, ropes: int) -> str:
    """Return MJCF of the ropes, straight along x, with sockets at their ends 1 and grippers or sockets at ends 0.

    Args:
        spec: Size and material of each rope; the first ``spec.grippers`` ropes have grippers.
        ropes: Number of ropes.
    """
    return "\n".join(_rope_bodies(spec, rope) for rope in range(ropes))


def _rope_bodies(spec: ChainSpec, rope: int) -> str:
    link, radius, rgba = spec.link_length, spec.radius, " ".join(map(str, spec.rgba))
    capsule = f'type="capsule" fromto="0 0 0 {link} 0 0" size="{radius}" group="{OBJECT_GROUP}" rgba="{rgba}"'
    foot = f'type="sphere" pos="{link} 0 0" size="{radius}" mass="0" group="3" rgba="0 0 0 0"'
    hinge = f'type="hinge" damping="{spec.damping}" armature="{_ARMATURE}"'
    x, y = -spec.length / 2, _APART * rope
    parts = [f'<body name="rope{rope}_socket" mocap="true" pos="{x} {y} {radius}">']
    for i in range(spec.links):
        name = f"rope{rope}_link{i}"
        parts.append(f'<body name="{name}" pos="{link if i else radius} 0 0"><geom name="{name}" {capsule}/>')
        parts.append(f'<geom name="rope{rope}_foot{i}" {foot}/>')
        if i:
            parts.append(f'<joint name="rope{rope}_pitch{i}" axis="0 1 0" stiffness="{VERTICAL}" {hinge}/>')
            parts.append(f'<joint name="rope{rope}_yaw{i}" axis="0 0 1" stiffness="{spec.stiffness}" {hinge}/>')
        else:
            parts.append(jaws(spec, -radius, -1))
    parts += [jaws(spec, link + radius, 1), "</body>" * (spec.links + 1)]
    parts.append(f'<body name="{holder(rope, spec.grippers)}" mocap="true" pos="{-x} {y} {radius}"/>')
    return "".join(parts)


def ropes_equality(spec: ChainSpec, ropes: int) -> str:
    """Return MJCF of the welds of the ends 0 to what holds them."""
    return "".join(
        f'<weld body1="{holder(rope, spec.grippers)}" body2="rope{rope}_link{spec.links - 1}" {_HELD}/>'
        for rope in range(ropes)
    )


def ropes_sections(spec: ChainSpec, ropes: int) -> str:
    """Return MJCF of the physics' options, the contacts, and the skins that OpenGL draws."""
    links = range(spec.links)
    pairs = [
        f'<pair geom1="table" geom2="rope{rope}_foot{i}" condim="1" {_TOUCH}/>' for rope in range(ropes) for i in links
    ]
    pairs += [
        f'<pair geom1="rope{one}_link{i}" geom2="rope{other}_link{j}" condim="3" friction=".1 .1" {_TOUCH}/>'
        for one, other in combinations(range(ropes), 2)
        for i, j in product(links, links)
    ]
    skins = (tube_skin(rope_tube(spec, rope), spec.links, spec.rgba, f"rope{rope}_") for rope in range(ropes))
    return f"{_OPTION}<contact>{''.join(pairs)}</contact>{''.join(skins)}"


def rope_tube(spec: ChainSpec, rope: int) -> Tube:
    """Return the form of the skin of a rope."""
    return chain_tube(spec, spec.radius)._replace(origin=np.array([spec.radius - spec.length / 2, _APART * rope]))


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
