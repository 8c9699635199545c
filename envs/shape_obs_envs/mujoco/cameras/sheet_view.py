"""A sheet as the two cameras draw it: one surface, lit from either side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies.sheet_mesh import SKIN, SheetMesh
from shape_obs_envs.mujoco.cameras.raster import draw_triangles
from shape_obs_envs.mujoco.cameras.shading import shade, to_bytes
from shape_obs_envs.mujoco.cameras.texture import Texture

Array = NDArray[np.float64]


class SheetView:
    """The sheet of a model, for the camera that draws it.

    Args:
        model: The compiled model.
        mesh: Its sheet.
    """

    def __init__(self, model: Any, mesh: SheetMesh) -> None:
        self._model, self._mesh = model, mesh
        self._skin = model.skin(SKIN).id
        self.refresh()

    @classmethod
    def of(cls, model: Any) -> SheetView | None:
        """The view of a model's sheet; None where it has none."""
        mesh = SheetMesh.of(model)
        return None if mesh is None else cls(model, mesh)

    def refresh(self) -> None:
        """Take over the present print."""
        texture = Texture.of(self._model, int(self._model.skin_matid[self._skin]))
        self._texture = None if texture is None or texture.is_white else texture

    def fill(self, scene: Any, data: Any) -> None:
        """Put the surface into a scene that `mjv_updateScene` has just made, whose skin follows the masses straight.

        The skin holds it twice, the second time turned over: culled back faces then light it from both sides.
        """
        vertices = self._mesh.vertices(data)
        normals = self._mesh.normals(vertices).ravel()
        start = 3 * int(scene.skinvertadr[self._skin])
        stop = start + 2 * vertices.size
        scene.skinvert[start:stop] = np.tile(vertices.ravel(), 2)
        scene.skinnormal[start:stop] = np.concatenate([normals, -normals])

    def paint(
        self,
        data: Any,
        project: Callable[[Array], tuple[Array, Array]],
        rgb: NDArray[np.uint8],
        depth: NDArray[np.float32],
    ) -> None:
        """Draw the surface into a picture (H, W, 3) with depths (H, W) [m] where it is nearer.

        Args:
            data: The state to draw.
            project: Takes world points (N, 3) to pixels (N, 2) and depths (N,) [m].
            rgb: Changed in place.
            depth: Changed in place; 0 is nothing.
        """
        vertices = self._mesh.vertices(data)
        normals = self._mesh.normals(vertices).reshape(-1, 3)
        faces = self._mesh.grid.faces
        places, away = project(vertices.reshape(-1, 3))
        drawn = draw_triangles(places, away, faces, depth.shape)
        behind = depth.reshape(-1)[drawn.pixels]
        front = (drawn.depth < behind) | (behind == 0)
        pixels, face, shares = drawn.pixels[front], drawn.faces[front], drawn.shares[front]
        corners = places[faces]
        (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
        above = (ax * by - ay * bx < 0)[face]  # anticlockwise in space, and v points down
        rgba = self._model.skin_rgba[self._skin]
        sides = np.stack([shade(self._model, data, rgba, sign * normals) for sign in (-1.0, 1.0)])
        colours = sides[above.astype(int)[:, None], faces[face]]
        seen = np.einsum("pk,pkc->pc", shares, colours)
        if self._texture is not None:
            seen = seen * self._print(self._texture, places, faces[face], face, shares)
        rgb.reshape(-1, 3)[pixels] = to_bytes(seen)
        depth.reshape(-1)[pixels] = drawn.depth[front]

    def _print(
        self, texture: Texture, places: Array, corners: NDArray[np.int64], face: NDArray[np.int64], shares: Array
    ) -> NDArray[np.float32]:
        """What the print makes of the colours (P, 3) of pixels on triangles.

        Args:
            texture: The print.
            places: (V, 2) of the vertices in the image [px].
            corners: (P, 3) vertices of the pixels' triangles.
            face: (P,) which triangles they are.
            shares: (P, 3) of the vertices at the pixels.
        """
        on_cloth = self._mesh.grid.places
        faces = self._mesh.grid.faces
        in_image, in_texels = (
            np.abs(np.linalg.det(points[faces[:, 1:]] - points[faces[:, :1]]))  # twice the triangles' areas
            for points in (places, on_cloth * texture.shape[::-1])
        )
        fineness = np.sqrt(in_texels / np.maximum(in_image, 1e-6))
        return texture.sample(np.einsum("pk,pkc->pc", shares, on_cloth[corners]), fineness[face])
