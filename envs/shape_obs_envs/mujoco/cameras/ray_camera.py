"""Camera without OpenGL: rays where geoms may be, planes in closed form, a sheet by its triangles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.cameras.rasterizer import SheetView, Texture, shade, to_bytes
from shape_obs_envs.mujoco.scene import CAMERA, CameraSpec, cast_rays, mujoco

Array = NDArray[np.float64]

_CAPSULE, _PLANE = int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_PLANE)
_NEAR = 0.05  # metres
_SKIP = 8  # pixels
_SHIFT = 4  # OpenCV draws with a precision of 1/16 pixel


class RayCamera:
    """Cast a ray for each pixel that a geom may cover, draw a sheet by its triangles, and shade as OpenGL does.

    Args:
        spec: Size and intrinsics of the camera.
        model: A model from ``compile_scene``.
    """

    name = "rays"

    def __init__(self, spec: CameraSpec, model: Any) -> None:
        self._model = model
        self._shape = (spec.height, spec.width)
        self._k = spec.intrinsics
        self._camera = model.camera(CAMERA).id
        self._planes = np.flatnonzero(model.geom_type == _PLANE)
        u, v = np.meshgrid(np.arange(spec.width), np.arange(spec.height))
        self._rays = np.stack([(u - self._k.cx) / self._k.fx, (v - self._k.cy) / self._k.fy, np.ones(u.shape)], axis=-1)
        self._sheet = SheetView.of(model)
        self._pose = np.zeros(0)
        self._background: tuple[NDArray[np.uint8], NDArray[np.float32]] | None = None

    def render(self, data: Any) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Render RGB ``(H, W, 3)`` and depth ``(H, W)`` in metres along the optical axis."""
        # MuJoCo's camera looks along its -z with y up; rays here are in the optical frame.
        rotation = data.cam_xmat[self._camera].reshape(3, 3) * (1.0, -1.0, -1.0)
        eye = data.cam_xpos[self._camera].copy()
        rgb, depth = (image.copy() for image in self._empty_scene(data, rotation, eye))
        rows, columns = np.nonzero(self._region(data, rotation, eye))
        rays = self._rays[rows, columns]
        scale = np.linalg.norm(rays, axis=1)
        directions = (rays / scale[:, None]) @ rotation.T
        distance, geom = cast_rays(self._model, data, eye, directions)
        hit = (geom >= 0) & ~np.isin(geom, self._planes)
        rows, columns, geom, distance = rows[hit], columns[hit], geom[hit], distance[hit]
        depth[rows, columns] = distance / scale[hit]
        points = eye + directions[hit] * distance[:, None]
        rgb[rows, columns] = self._shade(data, geom, outward_normals(self._model, data, geom, points))
        if self._sheet is not None:
            self._sheet.draw(data, lambda points: self._project(points, rotation, eye), rgb, depth)
        return rgb, depth

    def refresh(self) -> None:
        """Redraw the empty scene and reload the sheet's texture."""
        self._background = None
        if self._sheet is not None:
            self._sheet.refresh()

    def close(self) -> None:
        """Do nothing: there is nothing to free."""

    def _empty_scene(self, data: Any, rotation: Array, eye: Array) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return the image of the planes alone, each without end, cached until the camera moves."""
        pose = np.concatenate([rotation.ravel(), eye])
        if self._background is None or not np.array_equal(pose, self._pose):
            rgb, depth = np.zeros((*self._shape, 3), np.uint8), np.full(self._shape, np.inf, np.float32)
            for plane in self._planes.tolist():
                self._draw_plane(data, plane, rotation, eye, rgb, depth)
            depth[np.isinf(depth)] = 0
            self._pose, self._background = pose, (rgb, depth)
        return self._background

    def _draw_plane(
        self, data: Any, plane: int, rotation: Array, eye: Array, rgb: NDArray[np.uint8], depth: NDArray[np.float32]
    ) -> None:
        """Draw the front of a plane into ``rgb`` ``(H, W, 3)`` and ``depth`` ``(H, W)``, where it is nearer."""
        axes = data.geom_xmat[plane].reshape(3, 3)
        towards = self._rays @ (axes[:, 2] @ rotation)
        with np.errstate(divide="ignore"):
            away = np.where(towards < 0, (data.geom_xpos[plane] - eye) @ axes[:, 2] / towards, np.inf)
        away = away.astype(np.float32)
        nearer = (away > 0) & (away < depth)
        depth[nearer] = away[nearer]
        colour = shade(self._model, data, self._model.geom_rgba[plane], axes[None, :, 2])[0]
        printed = self._plane_texture(plane, axes, data.geom_xpos[plane], rotation, eye, np.where(nearer, away, 0))
        rgb[nearer] = np.broadcast_to(to_bytes(colour * printed), rgb.shape)[nearer]

    def _plane_texture(
        self, plane: int, axes: Array, origin: Array, rotation: Array, eye: Array, depth: NDArray[np.float32]
    ) -> NDArray[Any]:
        """Return a plane's texture ``(H, W, 3)``, 0 ... 1, which multiplies its colour; ones if it has none."""
        material = int(self._model.geom_matid[plane])
        texture = Texture.of(self._model, material)
        if texture is None:
            return np.ones(3)
        to_texture = (0.5, -0.5) * self._model.mat_texrepeat[material]  # it repeats every two metres / texrepeat
        along = axes[:, :2]
        places = (
            (self._rays * depth[..., None]) @ (rotation.T @ along * to_texture) + (eye - origin) @ along * to_texture
        ) - 0.5
        # The distance from pixel to pixel changes slowly, so a few of them suffice.
        few = places[::_SKIP, ::_SKIP] * texture.shape[::-1] / _SKIP
        steps = [np.linalg.norm(np.gradient(few, axis=axis), axis=-1) for axis in (0, 1)]
        fineness = cv2.resize(np.maximum(*steps).astype(np.float32), self._shape[::-1])
        return texture.sample(places, fineness)

    def _region(self, data: Any, rotation: Array, eye: Array) -> NDArray[np.uint8]:
        """Return a mask ``(H, W)`` of the pixels that geoms other than planes may cover, with a small margin."""
        mask = np.zeros(self._shape, np.uint8)
        model = self._model
        seen = np.flatnonzero(model.geom_rgba[:, 3] > 0)
        seen = seen[model.geom_type[seen] != _PLANE]
        round_ = model.geom_type[seen] == _CAPSULE
        ids = seen[round_]
        axis = data.geom_xmat[ids].reshape(-1, 3, 3)[:, :, 2] * model.geom_size[ids, 1, None]
        ends = np.stack([data.geom_xpos[ids] - axis, data.geom_xpos[ids] + axis], axis=1)
        pixels, z = self._project(ends.reshape(-1, 3), rotation, eye)
        if len(z) and z.min() < _NEAR:  # next to the camera or behind it: such an end cannot be projected
            return np.ones(self._shape, np.uint8)
        pixels = pixels.reshape(-1, 2, 2)
        # seen obliquely, a sphere's outline is an ellipse, longer than its width by the ray's slant
        reach = self._k.fx * model.geom_size[ids, 0] / z.reshape(-1, 2).min(axis=1) * self._slant(pixels)
        for (a, b), width in zip(_fixed(pixels).tolist(), np.ceil(2 * reach + 3).astype(int).tolist(), strict=True):
            cv2.line(mask, a, b, 1, width, cv2.LINE_8, _SHIFT)
        ids = seen[~round_]
        pixels, z = self._project(data.geom_xpos[ids], rotation, eye)
        reach = self._k.fx * model.geom_rbound[ids] / (z - model.geom_rbound[ids]) * self._slant(pixels[:, None]) + 2
        for centre, radius in zip(_fixed(pixels).tolist(), (reach * 2**_SHIFT).astype(int).tolist(), strict=True):
            cv2.circle(mask, centre, radius, 1, -1, cv2.LINE_8, _SHIFT)
        return mask

    def _project(self, points: Array, rotation: Array, eye: Array) -> tuple[Array, Array]:
        """Project world points ``(N, 3)`` to pixels ``(N, 2)`` and depths ``(N,)``."""
        local = (points - eye) @ rotation
        z = np.maximum(local[:, 2], 1e-3)
        return local[:, :2] / z[:, None] * (self._k.fx, self._k.fy) + (self._k.cx, self._k.cy), z

    def _slant(self, pixels: Array) -> Array:
        """Return how much longer a sphere's outline is than at the image centre: ``(N, K, 2)`` pixels -> ``(N,)``."""
        tangent = (pixels - (self._k.cx, self._k.cy)) / (self._k.fx, self._k.fy)
        return np.sqrt(1 + (tangent**2).sum(axis=-1)).max(axis=1)

    def _shade(self, data: Any, geom: NDArray[Any], facing: Array) -> NDArray[np.uint8]:
        """Return colours ``(M, 3)`` of surfaces with unit normals ``facing`` ``(M, 3)``."""
        return to_bytes(shade(self._model, data, self._model.geom_rgba[geom], facing))


def _fixed(pixels: Array) -> NDArray[np.int32]:
    """Convert pixels to OpenCV's fixed-point coordinates."""
    return np.rint(pixels * 2**_SHIFT).astype(np.int32)


def outward_normals(model: Any, data: Any, geoms: NDArray[np.int32], points: Array) -> Array:
    """Return outward unit normals ``(M, 3)`` of ``geoms`` ``(M,)`` at surface ``points`` ``(M, 3)``, world frame."""
    rotation = data.geom_xmat[geoms].reshape(-1, 3, 3)
    local = np.einsum("mji,mj->mi", rotation, points - data.geom_xpos[geoms])
    size, kinds = model.geom_size[geoms], model.geom_type[geoms]
    out = np.empty_like(local)
    for kind in np.unique(kinds):
        here = kinds == kind
        out[here] = _OUTWARD[int(kind)](local[here], size[here])
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    return np.einsum("mij,mj->mi", rotation, out)


def _sphere(points: Array, size: Array) -> Array:
    return points


def _ellipsoid(points: Array, size: Array) -> Array:
    return points / size**2


def _capsule(points: Array, size: Array) -> Array:
    out = points.copy()
    out[:, 2] -= np.clip(points[:, 2], -size[:, 1], size[:, 1])
    return out


def _cylinder(points: Array, size: Array) -> Array:
    lid = size[:, 1] - np.abs(points[:, 2]) < size[:, 0] - np.hypot(points[:, 0], points[:, 1])
    return np.where(lid[:, None], points * (0.0, 0.0, 1.0), points * (1.0, 1.0, 0.0))


def _box(points: Array, size: Array) -> Array:
    rows, face = np.arange(len(points)), np.argmax(np.abs(points) / size, axis=1)
    out = np.zeros_like(points)
    out[rows, face] = np.sign(points[rows, face])
    return out


_OUTWARD: Final[dict[int, Callable[[Array, Array], Array]]] = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): _sphere,
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID): _ellipsoid,
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): _capsule,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): _cylinder,
    int(mujoco.mjtGeom.mjGEOM_BOX): _box,
}
