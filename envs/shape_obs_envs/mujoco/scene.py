"""MuJoCo scenes: the module itself, the table with its light and camera, and rays into a scene."""

from __future__ import annotations

import importlib
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.utils.errors import install_hint
from shape_obs_envs.arguments import one_of


def _import_mujoco() -> Any:
    """Import MuJoCo, which loads the OpenGL of ``MUJOCO_GL``: without it if that fails, since rays need none."""
    before = {name: os.environ.get(name) for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    try:
        return importlib.import_module("mujoco")
    except (ImportError, AttributeError, TypeError, ValueError, OSError, RuntimeError) as error:
        if not before["MUJOCO_GL"] or getattr(error, "name", "") == "mujoco":
            raise
        os.environ["MUJOCO_GL"] = "disable"
        return importlib.import_module("mujoco")
    finally:
        for name, value in before.items():  # a backend that cannot be loaded leaves its own platform behind
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


try:
    # Any: the module's names come from C extensions, which a type checker sees only in part.
    mujoco: Any = _import_mujoco()
except ModuleNotFoundError as error:
    if error.name != "mujoco":  # MuJoCo is installed but lacks one of its own dependencies: keep that message
        raise
    raise ImportError(
        f"The simulated environments need MuJoCo, which is not installed: {install_hint('sim')} "
        '(or anywhere: pip install "mujoco>=3.3").'
    ) from error

CAMERA = "camera"
TIMESTEP = 0.01
#: Focal length of a D455's colour stream at 480 rows in pixels; other sizes keep the vertical field of view.
_FOCAL_480 = 386.0
_SIZES = {"rl": (160, 120), "d455": (640, 480)}
_SMALLEST, _LARGEST = 16, 4096
# The `normal` argument was inserted into the middle of the list by MuJoCo 3.5.
_NORMAL = (None,) if "normal:" in (mujoco.mj_multiRay.__doc__ or "") else ()
_CUTOFF = 10.0


@dataclass(frozen=True)
class CameraSpec:
    """An RGB-D camera above the table, on the -y side.

    Attributes:
        width: Image width in pixels.
        height: Image height in pixels.
        distance: Distance from the camera to the point that it looks at, in metres.
        tilt: Angle between the optical axis and the vertical in radians.
        aim: The point (x, y, z) that it looks at, in metres, world frame.
    """

    width: int
    height: int
    distance: float = 0.56
    tilt: float = math.radians(10)
    aim: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def intrinsics(self) -> Intrinsics:
        """Pinhole intrinsics; the principal point is the image centre, pixel centres are at integers."""
        focal = _FOCAL_480 * self.height / 480
        return Intrinsics(self.width, self.height, focal, focal, (self.width - 1) / 2, (self.height - 1) / 2)

    @property
    def fovy(self) -> float:
        """Vertical field of view in degrees."""
        return math.degrees(2 * math.atan(480 / 2 / _FOCAL_480))


def camera_spec(camera: str | Sequence[int], name: str = "camera", **view: Any) -> CameraSpec:
    """Return the camera for the value of an environment's argument ``name``, with ``distance``, ``tilt`` or ``aim``.

    Raises:
        ValueError: It is neither a known name nor a size in pixels.
    """
    if isinstance(camera, str):
        return CameraSpec(*_SIZES[one_of(name, camera, _SIZES, "[width, height]")], **view)
    size = list(camera) if isinstance(camera, (list, tuple)) else []
    whole = [isinstance(side, (int, np.integer)) and not isinstance(side, bool) for side in size]
    if len(size) != 2 or not all(whole) or not all(_SMALLEST <= side <= _LARGEST for side in size):
        names = ", ".join(map(repr, _SIZES))
        raise ValueError(
            f"{name}: expected {names} or [width, height] with two whole numbers from {_SMALLEST} to {_LARGEST}, "
            f"got {camera!r}. For square training frames write {name}=[84, 84]."
        )
    if size[0] < size[1]:
        raise ValueError(
            f"{name}: expected a width of at least the height, to keep the whole workspace in view, got {camera!r}. "
            f"Write {name}=[{size[1]}, {size[1]}] or {name}=[{size[1]}, {size[0]}]."
        )
    return CameraSpec(int(size[0]), int(size[1]), **view)


def compile_scene(camera: CameraSpec, bodies: str, equality: str = "", sections: str = "") -> Any:
    """Compile a scene from MJCF parts.

    The world frame is the robot's base frame: origin on the table, below the camera's aim, z up, x to the right in the
    image.

    Args:
        camera: The camera.
        bodies: Bodies on the table.
        equality: Equality constraints.
        sections: Further top-level sections.

    Returns:
        The compiled ``mujoco.MjModel``.
    """
    sin, cos = math.sin(camera.tilt), math.cos(camera.tilt)
    x, y, z = camera.aim
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{TIMESTEP}" integrator="implicitfast" viscosity="1">
    <flag contact="disable" gravity="disable"/>
  </option>
  <statistic center="0 0 0" extent="1"/>
  <visual>
    <global offwidth="{camera.width}" offheight="{camera.height}"/>
    <quality numslices="10" numstacks="6" numquads="1" offsamples="0" shadowsize="0"/>
    <map znear="0.05" zfar="4"/>
    <headlight active="0"/>
  </visual>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <light name="lamp" pos="0 0 2" dir=".25 .35 -1" ambient=".4 .4 .4" diffuse=".6 .6 .6" specular="0 0 0"
           castshadow="false"/>
    <camera name="{CAMERA}" pos="{x} {y - camera.distance * sin} {z + camera.distance * cos}"
            xyaxes="1 0 0 0 {cos} {sin}" fovy="{camera.fovy}"/>
    <geom name="table" type="plane" size="4 4 .1" rgba=".8 .78 .74 1"/>
    {bodies}
  </worldbody>
  <equality>{equality}</equality>
  {sections}
</mujoco>""")
    if hasattr(model, "light_type"):
        model.light_type[:] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    else:  # MuJoCo 3.3.0 and 3.3.1; later versions have no such attribute in MJCF either
        model.light_directional[:] = 1
    return model


def camera_model(spec: CameraSpec, model: Any, data: Any) -> CameraModel:
    """Return intrinsics and pose of the scene's camera.

    The pose is p_base = T p_camera, with the optical frame x right, y down, z forward.
    """
    index = model.camera(CAMERA).id
    transform = np.eye(4)
    # MuJoCo's camera looks along its -z with y up
    transform[:3, :3] = data.cam_xmat[index].reshape(3, 3) * (1.0, -1.0, -1.0)
    transform[:3, 3] = data.cam_xpos[index]
    return CameraModel(spec.intrinsics, transform)


def cast_rays(
    model: Any, data: Any, eye: NDArray[np.float64], directions: NDArray[np.float64], groups: tuple[int, ...] = ()
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Cast rays from one point and return their first hits; one signature for MuJoCo 3.3 and later.

    Args:
        model: The MuJoCo model.
        data: Its data, with up-to-date kinematics.
        eye: Start of the rays, shape ``(3,)``, in metres, world frame.
        directions: Unit vectors of shape ``(M, 3)``, world frame.
        groups: Geom groups that rays can hit; all if empty.

    Returns:
        Distances ``(M,)`` in metres and geom ids ``(M,)``; both -1 where a ray hits nothing.
    """
    n = len(directions)
    distances, geoms = np.full(n, -1.0), np.full(n, -1, np.int32)
    if n:
        mask = None
        if groups:
            mask = np.zeros(6, np.uint8)
            mask[list(groups)] = 1
        flat = np.ascontiguousarray(directions, np.float64).ravel()
        mujoco.mj_multiRay(model, data, eye, flat, mask, 1, -1, geoms, distances, *_NORMAL, n, _CUTOFF)
    return distances, geoms
