"""A chain of capsules, and its planar form: a rope that lies on a table and is held at one end or both.

The planar chain is inextensible (rigid links) and bends at hinges with low stiffness and damping. The drag of a viscous
medium models the friction of the table. Gravity and contacts are off: nothing falls, nothing collides. A held end link
is welded to a mocap body, its gripper.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs.geometry.polyline import interpolate
from shape_obs_envs.mujoco.bodies import GRIPPERS, OBJECT_GROUP, Body, MaterialFactors, PlanarBody
from shape_obs_envs.mujoco.bodies.tube import Station, Tube, reshape_tube, rounded_ends, set_tube_colours, tube_skin
from shape_obs_envs.mujoco.scene import mujoco

Array = NDArray[np.float64]

_SIDES = 20  # of the rendered tube


@dataclass(frozen=True)
class ChainSpec:
    """Size and material of the chain. Lengths are in metres, from tip to tip (caps included).

    Attributes:
        stiffness: Bending stiffness in N m / rad.
        damping: Bending damping in N m s / rad. Without stiffness, the rope keeps its bends.
        grippers: 2 to hold both ends, 1 to hold end 0 only.
    """

    length: float = 0.5
    radius: float = 0.008
    links: int = 32
    stiffness: float = 0.05
    damping: float = 6e-4
    grippers: int = 2
    rgba: tuple[float, float, float, float] = (0.05, 0.25, 0.95, 1.0)

    @property
    def link_length(self) -> float:
        """Distance of neighbouring hinges in metres; each end link has a cap of one radius beyond it."""
        return (self.length - 2 * self.radius) / self.links


def chain_bodies(spec: ChainSpec) -> str:
    """Return MJCF of the chain, straight along x about the world's origin, with its grippers."""
    link = spec.link_length
    rgba = " ".join(map(str, spec.rgba))
    parts = [f'<body name="link0" pos="{-link * spec.links / 2} 0 {spec.radius}">']
    parts.append('<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>')
    parts.append('<joint name="heading" type="hinge" axis="0 0 1"/>')
    for i in range(spec.links):
        if i:
            parts.append(f'<body name="link{i}" pos="{link} 0 0">')
            parts.append(
                f'<joint name="bend{i}" type="hinge" axis="0 0 1" stiffness="{spec.stiffness}" '
                f'damping="{spec.damping}" armature="1e-6"/>'
            )
        parts.append(
            f'<geom name="link{i}" type="capsule" fromto="0 0 0 {link} 0 0" size="{spec.radius}" '
            f'group="{OBJECT_GROUP}" rgba="{rgba}"/>'
        )
        if i == 0:
            parts.append(jaws(spec, -spec.radius, -1))
    if spec.grippers == 2:
        parts.append(jaws(spec, link + spec.radius, 1))
    parts.append("</body>" * spec.links)
    parts += [
        f'<body name="{name}" mocap="true" pos="{sign * spec.length / 2} 0 {spec.radius}"/>'
        for name, sign in zip(GRIPPERS[: spec.grippers], (-1, 1), strict=False)
    ]
    return "\n".join(parts)


def chain_skin(spec: ChainSpec) -> str:
    """Return MJCF of the skin that OpenGL draws instead of the capsules."""
    return tube_skin(chain_tube(spec, spec.radius), spec.links, spec.rgba)


def chain_tube(spec: ChainSpec, height: float) -> Tube:
    """Return the form of the skin of a chain along x about x = 0, with its axis at ``height`` in metres."""
    link, links = spec.link_length, spec.links
    start, end = rounded_ends(link * links, spec.radius, links - 1)
    middle = [Station(link * i, 1.0, (i - 1, i)) for i in range(1, links)]
    angle = np.linspace(0, 2 * np.pi, _SIDES, endpoint=False)
    # The profile has a corner on each side, so that the tube has its full width seen from above.
    profile = spec.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    stations = [*start, Station(0.0, 1.0, (0,)), *middle, Station(link * links, 1.0, (links - 1,)), *end]
    return Tube(stations, profile, height, link, np.array([-link * links / 2, 0.0]))


def chain_equality(spec: ChainSpec) -> str:
    """Return MJCF of the welds of the end links to their grippers."""
    ends = ("link0", f"link{spec.links - 1}")
    return "\n".join(
        f'<weld body1="{gripper}" body2="{link}" solref=".02 1" solimp=".95 .99 .001"/>'
        for gripper, link in zip(GRIPPERS[: spec.grippers], ends, strict=False)
    )


def jaws(spec: ChainSpec, tip: float, sign: int) -> str:
    """Return MJCF of the visible gripper: two fingers next to the tip and a palm beyond it, in the direction ``sign``.

    The geoms are on the end link, not on the mocap body, which is a few millimetres ahead because of the compliant
    weld. They do not reach above the rope's axis, and a gap of 0.35 r surrounds the rope, so the gripper never occludes
    the rope for lines of sight within 42 degrees of the vertical.
    """
    shades = (".24", ".24", ".18")
    return "".join(
        f'<geom type="box" mass="0" rgba="{shade} {shade} {shade} 1" size="{" ".join(map(str, size))}" '
        f'pos="{" ".join(map(str, place))}"/>'
        for shade, (size, place) in zip(shades, jaw_boxes(spec.radius, tip, sign), strict=True)
    )


def jaw_boxes(r: float, tip: float, sign: int) -> Iterator[tuple[Sequence[float], Sequence[float]]]:
    """Yield half sizes and places ``(3,)`` in metres of the two fingers and the palm for a rope of radius ``r``."""
    gap, thick, ahead, palm = 1.35 * r, 0.006, 0.018, 0.02
    behind = 0.35 * r + palm
    for side in (-1, 1):
        place = tip + sign * (behind - ahead) / 2, side * (gap + thick / 2), -r / 2
        yield ((ahead + behind) / 2, thick / 2, r / 2), place
    yield (palm / 2, gap, r / 2), (tip + sign * (behind - palm / 2), 0, -r / 2)


class Rope(Body):
    """A chain in a compiled model, whatever its joints: colours and true shape.

    Args:
        spec: Nominal size and material, from which the model was compiled.
        model: The compiled model; its links are "link0", "link1", ..., bodies and geoms alike.

    Attributes:
        nominal: Nominal size and material.
        spec: Size with the present radius.
    """

    def __init__(self, spec: ChainSpec, model: Any) -> None:
        super().__init__(model, GRIPPERS[: spec.grippers])
        self.nominal = self.spec = spec
        self._bodies = np.array([model.body(f"link{i}").id for i in range(spec.links)])
        self._geoms = np.array([model.geom(f"link{i}").id for i in range(spec.links)])
        self._arc = arc_lengths(spec)

    @property
    def _height(self) -> float:
        """Height of the axis in metres in the model's initial configuration."""
        return self.spec.radius

    @property
    def colour(self) -> tuple[float, float, float]:
        """Nominal red, green and blue, 0 ... 1."""
        return self.nominal.rgba[:3]

    @property
    def tone_shape(self) -> tuple[int, int]:
        """One tone per link."""
        return self.spec.links, 1

    def landmarks(self) -> Array:
        """Return points ``(20, 3)`` on the first and last tenth of the axis, in metres, world frame."""
        return self.points(np.concatenate([np.linspace(0.0, 0.1, 10), np.linspace(0.9, 1.0, 10)]))

    def set_colours(self, rgb: Sequence[float], tones: NDArray[Any]) -> None:
        """Set its colour to ``rgb``, 0 ... 1, times a factor in ``tones`` ``(links, 1)`` for each link."""
        self.model.geom_rgba[self._geoms, :3] = tones * rgb
        set_tube_colours(self.model, rgb, tones[:, 0])

    def vertices(self) -> Array:
        """Return the axis as a polyline ``(links + 1, 3)`` from tip to tip, in metres, world frame."""
        joints = self.data.xpos[self._bodies]
        out = np.empty((len(joints) + 1, 3))
        out[1:-1] = joints[1:]
        along = self.data.xmat[self._bodies[[0, -1]]].reshape(2, 3, 3)[:, :, 0]
        out[0] = joints[0] - self.spec.radius * along[0]
        out[-1] = joints[-1] + (self.spec.link_length + self.spec.radius) * along[1]
        return out

    def points(self, fractions: Array) -> Array:
        """Return points ``(n, 3)`` of the axis at ``fractions`` ``(n,)`` of its arc length, in metres, world frame."""
        return interpolate(self.vertices(), self._arc, fractions * self.spec.length)

    def _resize(self, thickness: float, length: float = 1.0) -> tuple[float, float]:
        """Set the size to factors of the nominal one; return the radius and the length of a link, in metres."""
        model, nominal = self.model, self.nominal
        self.spec = spec = replace(nominal, radius=nominal.radius * thickness, length=nominal.length * length)
        self._arc = arc_lengths(spec)
        radius, link = spec.radius, spec.link_length  # longer caps make the links shorter
        model.body_pos[self._bodies[1:], 0] = link
        model.geom_size[self._geoms, :2] = radius, link / 2
        model.geom_pos[self._geoms, 0] = model.body_ipos[self._bodies, 0] = link / 2
        reshape_tube(model, chain_tube(spec, self._height))
        return radius, link


class Chain(Rope, PlanarBody):
    """The planar chain in a compiled model: poses, state and stepping."""

    @property
    def underlay(self) -> float:
        """Less than half the height of the axis, where a rope seen from above is widest, in metres."""
        return 0.4 * self.spec.radius

    def set_material(self, factors: MaterialFactors) -> None:
        """Change its material; it must be placed again after that. Mass and inertia stay the same."""
        model, nominal = self.model, self.nominal
        radius, link = self._resize(factors.thickness)
        model.body_pos[self._bodies[0]] = -link * nominal.links / 2, 0.0, radius
        model.body_pos[self._held_by, 2] = radius
        ends = [(0, -radius, -1), (-1, link + radius, 1)][: nominal.grippers]
        for weld, (end, tip, sign) in enumerate(ends):
            model.eq_data[weld, 3] = -tip  # position of the link relative to the gripper
            for i, (size, place) in enumerate(jaw_boxes(radius, tip, sign)):
                jaw = self._geoms[end] + 1 + i
                model.geom_size[jaw], model.geom_pos[jaw] = size, place
                model.geom_rbound[jaw] = np.linalg.norm(size)
        self._set_bending(slice(3, 2 + nominal.links), nominal.stiffness, nominal.damping, factors)

    def place(self, tip: Array, headings: Array) -> None:
        """Place the chain at rest with its first tip at ``tip`` (x, y) and its links at ``headings`` ``(links,)``."""
        mujoco.mj_resetData(self.model, self.data)
        first = self.model.body("link0").pos[:2]
        start = tip + self.spec.radius * np.array([np.cos(headings[0]), np.sin(headings[0])])
        self.data.qpos[:2] = start - first
        self.data.qpos[2] = headings[0]
        self.data.qpos[3:] = np.diff(headings)
        self.refresh()
        self.set_grippers(self.gripper_poses())

    def span(self, headings: Array) -> Array:
        """Return the vector ``(2,)`` between the tips of a chain with links at ``headings`` ``(links,)``."""
        return np.diff(self._arc) @ np.column_stack([np.cos(headings), np.sin(headings)])

    def tip_poses(self) -> Array:
        """Return the poses ``(2, 3)`` of the tips: x, y in metres and heading in radians, world frame."""
        heading = np.array([self.data.qpos[2], self.data.qpos[2:].sum()])
        return np.column_stack([self.vertices()[[0, -1], :2], heading])

    def gripper_poses(self) -> Array:
        """Return the poses ``(G, 3)`` of the held tips: x, y in metres and heading in radians, world frame."""
        return self.tip_poses()[: self.spec.grippers]


def arc_lengths(spec: ChainSpec) -> Array:
    """Return the arc lengths ``(links + 1,)`` in metres from the first tip to each vertex of ``Chain.vertices``."""
    cuts = np.full(spec.links, spec.link_length)
    cuts[[0, -1]] += spec.radius
    return np.concatenate([[0.0], np.cumsum(cuts)])
