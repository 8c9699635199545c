"""A chain of capsules in space: the physics of a rope that hangs under gravity from one gripper or two.

The chain is inextensible (rigid links) and bends at universal joints, two hinges each, with low stiffness and damping:
without twist it has a third fewer coordinates than with ball joints. The drag of a viscous medium damps its swings
within a second. Contacts are off: nothing collides.

Each tip is pinched by a palm, in which it turns freely. The first palm slides in x, y and z, carries the links, and
follows the target of its gripper, a mocap body, as does the second palm at the other end: in one tree of bodies, no
constraint opens between palm and rope.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from shape_obs_envs.mujoco.bodies import GRIPPERS, OBJECT_GROUP, MaterialFactors
from shape_obs_envs.mujoco.bodies.chain import ChainSpec, Rope, chain_tube
from shape_obs_envs.mujoco.bodies.tube import tube_skin
from shape_obs_envs.mujoco.scene import mujoco

Array = NDArray[np.float64]

#: Height of the axis in the model's initial configuration, straight along x, in metres.
_HEIGHT = 0.4
#: Euler's method is explicit in the drag: integrating it implicitly takes three times as long. It needs half the usual
#: timestep, and damping of this size: with a third of it, links whirl when a gripper jerks them at full speed.
_OPTION = '<option timestep="0.005" integrator="Euler" viscosity="0.4"><flag gravity="enable"/></option>'
_FOLLOW = 'solref=".02 1" solimp=".95 .99 .001"'
_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
_SLIDES = "".join(f'<joint name="{axis}" type="slide" axis="{way}"/>' for axis, way in _AXES.items())
_HINGES = ("pitch", _AXES["y"]), ("yaw", _AXES["z"])
#: The jaw stands above the tip and is thin, so that a camera from the front or from above sees the tip before it.
_PALM = (
    '<inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>'
    '<geom type="box" mass="0" rgba=".24 .24 .24 1" pos="0 0 .034" size=".012 .008 .016"/>'
    '<geom type="capsule" mass="0" rgba=".18 .18 .18 1" fromto="0 0 .002 0 0 .02" size=".003"/>'
)


def strand_bodies(spec: ChainSpec) -> str:
    """Return MJCF of the chain, straight along x about x = 0, with its palms and the targets of its grippers."""
    link, radius, rgba = spec.link_length, spec.radius, " ".join(map(str, spec.rgba))
    bend = f'stiffness="{spec.stiffness}" damping="{spec.damping}" armature="1e-5"'
    turn = 'type="ball" damping="2e-3" armature="1e-5"'
    capsule = f'type="capsule" fromto="0 0 0 {link} 0 0" size="{radius}" group="{OBJECT_GROUP}" rgba="{rgba}"'
    parts = [f'<body name="palm0" pos="{-spec.length / 2} 0 {_HEIGHT}" gravcomp="1">{_SLIDES}{_PALM}']
    for i in range(spec.links):
        parts.append(f'<body name="link{i}" pos="{link if i else radius} 0 0"><geom name="link{i}" {capsule}/>')
        if i:
            parts += [f'<joint name="{name}{i}" type="hinge" axis="{way}" {bend}/>' for name, way in _HINGES]
        else:
            parts.append(f'<joint name="turn0" {turn} pos="{-radius} 0 0"/>')
    if spec.grippers == 2:
        parts.append(
            f'<body name="palm1" pos="{link + radius} 0 0" gravcomp="1"><joint name="turn1" {turn}/>{_PALM}</body>'
        )
    parts.append("</body>" * (spec.links + 1))
    parts += [
        f'<body name="{name}" mocap="true" pos="{sign * spec.length / 2} 0 {_HEIGHT}"/>'
        for name, sign in zip(GRIPPERS[: spec.grippers], (-1, 1), strict=False)
    ]
    return "\n".join(parts)


def strand_equality(spec: ChainSpec) -> str:
    """Return MJCF of the constraints that make the palms follow their grippers."""
    # the first palm cannot turn, the second one can
    pairs = (
        f'<connect body1="gripper0" body2="palm0" anchor="0 0 0" {_FOLLOW}/>',
        f'<weld body1="gripper1" body2="palm1" {_FOLLOW}/>',
    )
    return "".join(pairs[: spec.grippers])


def strand_sections(spec: ChainSpec) -> str:
    """Return MJCF of the physics' options and of the skin that OpenGL draws instead of the capsules."""
    return _OPTION + tube_skin(chain_tube(spec, _HEIGHT), spec.links, spec.rgba)


class Strand(Rope):
    """The chain in space in a compiled model: poses, state and stepping.

    Args:
        spec: Nominal size and material, from which the model was compiled.
        model: The compiled model.
    """

    @property
    def _height(self) -> float:
        return _HEIGHT

    @property
    def underlay(self) -> float:
        """Height of objects on the table, far below the rope, in metres."""
        return 0.01

    def set_grippers(self, poses: Array) -> None:
        """Move the mocap bodies to ``poses`` ``(G, 3)``, in metres, world frame."""
        self.data.mocap_pos[self._grippers] = poses

    def gripper_targets(self) -> Array:
        """Return the positions ``(G, 3)`` of the mocap bodies, in metres, world frame."""
        return self.data.mocap_pos[self._grippers]

    def gripper_poses(self) -> Array:
        """Return the positions ``(G, 3)`` of the held tips, in metres, world frame."""
        return self.vertices()[[0, -1]][: self.spec.grippers]

    def set_material(self, factors: MaterialFactors) -> None:
        """Change its material; it must be placed again after that. Mass and inertia stay the same."""
        model, nominal = self.model, self.nominal
        radius, link = self._resize(factors.thickness, factors.length)
        model.body_pos[self._bodies[0], 0] = radius
        model.jnt_pos[model.joint("turn0").id, 0] = -radius
        if nominal.grippers == 2:
            model.body_pos[model.body("palm1").id, 0] = link + radius
        first = int(model.joint("pitch1").id)
        self._set_bending(slice(first, first + 2 * nominal.links - 2), nominal.stiffness, nominal.damping, factors)

    def place(self, poses: Array) -> None:
        """Place the chain at rest between ``poses`` ``(G, 3)`` of the tips, or straight down from a single one."""
        mujoco.mj_resetData(self.model, self.data)
        middles = (self._arc[:-1] + self._arc[1:]) / 2
        if self.spec.grippers == 1:
            way, pitch = np.array([1.0, 0.0, 0.0]), np.full(self.spec.links, -np.pi / 2)
        else:
            way = poses[1] - poses[0]
            pitch = catenary_pitch(float(np.hypot(*way[:2])), float(way[2]), self.spec.length, middles)
        heading, qpos = float(np.arctan2(way[1], way[0])), self.data.qpos
        qpos[:3] = poses[0] - self.model.body("palm0").pos
        qpos[3:7] = _turned(heading, pitch[0])
        qpos[7 : 5 + 2 * self.spec.links : 2] = -np.diff(pitch)
        if self.spec.grippers == 2:
            qpos[-4:] = _turned(heading, pitch[-1]) * (1, -1, -1, -1)  # back, so that the palm stands upright
        self.refresh()
        self.set_grippers(poses)


def catenary_pitch(across: float, up: float, length: float, arc: Array) -> Array:
    """Return the angles to the horizontal, in radians, of an inextensible limp line that hangs between two points.

    Args:
        across: Horizontal distance of the points in metres, above 0.
        up: Height of the last point above the first in metres.
        length: Length of the line in metres, more than the distance of the points.
        arc: Arc lengths ``(n,)`` from the first point in metres.

    Returns:
        Angles ``(n,)``, positive upwards. The line is a catenary, z = a cosh(x / a), with tan(angle) = s / a at the arc
        length s from its lowest point, and sqrt(length^2 - up^2) = 2 a sinh(across / 2 a).
    """
    slack = np.sqrt(length**2 - up**2) / across
    half: Any = brentq(lambda u: np.sinh(u) - slack * u, 1e-6, 50.0)
    a = across / (2 * half)
    return np.arctan(np.sinh(np.arctanh(up / length) - half) + arc / a)


def _turned(heading: float, pitch: float) -> Array:
    """Return the quaternion ``(4,)`` of a link with this heading and this angle to the horizontal, in radians."""
    h, p = heading / 2, -pitch / 2
    return np.array([np.cos(h) * np.cos(p), -np.sin(h) * np.sin(p), np.cos(h) * np.sin(p), np.sin(h) * np.cos(p)])
