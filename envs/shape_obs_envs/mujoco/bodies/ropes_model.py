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

from itertools import combinations, product
from typing import Final

import numpy as np

from shape_obs_envs.mujoco.bodies import GRIPPERS, OBJECT_GROUP
from shape_obs_envs.mujoco.bodies.chain import ChainSpec, chain_tube, jaws
from shape_obs_envs.mujoco.bodies.tube import Tube, tube_skin

_OPTION: Final = (
    '<option integrator="Euler" viscosity=".5" gravity="0 0 -30"><flag contact="enable" gravity="enable"/></option>'
)
#: Vertical bending stiffness in N m / rad.
VERTICAL: Final = 0.02
_ARMATURE: Final = 3e-5
_TOUCH: Final = 'solref=".02 1" solimp=".9 .95 .001"'
_HELD: Final = 'solref=".02 1" solimp=".95 .99 .001"'
_APART: Final = 0.1  # between the ropes in the model's initial configuration, in metres


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
