"""Software rasterizer for the sheet: triangles, textures and shading as in OpenGL; and the sheet in an OpenGL scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from shape_obs_envs.mujoco.bodies.sheet_mesh import SKIN, SheetMesh

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_TOLERANCE = 1e-9  # pixels: a centre on a shared edge belongs to both triangles, never to neither
_ROW = 1024  # see Texture.sample


class Drawn(NamedTuple):
    """Pixels covered by triangles.

    Args:
        pixels: Flat indices ``(P,)`` into the image, each once.
        faces: The nearest triangle there, ``(P,)``.
        shares: Barycentric coordinates in space, ``(P, 3)``: shares @ values interpolates vertex values.
        depth: Depth along the optical axis in metres, ``(P,)``.
    """

    pixels: Indices
    faces: Indices
    shares: Array
    depth: Array


class SheetView:
    """The sheet of a model, as drawn by a camera: one surface, lit from both sides.

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
        """Return the view of a model's sheet; None if it has none."""
        mesh = SheetMesh.of(model)
        return None if mesh is None else cls(model, mesh)

    def refresh(self) -> None:
        """Reload the texture."""
        texture = Texture.of(self._model, int(self._model.skin_matid[self._skin]))
        self._texture = None if texture is None or texture.is_white else texture

    def fill(self, scene: Any, data: Any) -> None:
        """Replace the skin, which follows the masses in straight lines, in a scene just made by ``mjv_updateScene``.

        The skin contains the surface twice, the second time turned over, so that with back-face culling it is lit from
        both sides.
        """
        vertices = self._mesh.vertices(data)
        normals = self._mesh.normals(vertices).ravel()
        start = 3 * int(scene.skinvertadr[self._skin])
        stop = start + 2 * vertices.size
        scene.skinvert[start:stop] = np.tile(vertices.ravel(), 2)
        scene.skinnormal[start:stop] = np.concatenate([normals, -normals])

    def draw(
        self,
        data: Any,
        project: Callable[[Array], tuple[Array, Array]],
        rgb: NDArray[np.uint8],
        depth: NDArray[np.float32],
    ) -> None:
        """Draw the surface into an image ``(H, W, 3)`` with depths ``(H, W)`` in metres where it is nearer.

        Args:
            data: The state to draw.
            project: Projects world points ``(N, 3)`` to pixels ``(N, 2)`` and depths ``(N,)`` in metres.
            rgb: The image; modified.
            depth: The depths, 0 where there is nothing; modified.
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
            seen = seen * self._sample(self._texture, places, face, shares)
        rgb.reshape(-1, 3)[pixels] = to_bytes(seen)
        depth.reshape(-1)[pixels] = drawn.depth[front]

    def _sample(self, texture: Texture, places: Array, face: Indices, shares: Array) -> NDArray[np.float32]:
        """Return the texture's colours ``(P, 3)`` at pixels on triangles.

        Args:
            texture: The texture.
            places: Vertices in the image, ``(V, 2)``, in pixels.
            face: Triangles of the pixels, ``(P,)``.
            shares: Barycentric coordinates of the pixels, ``(P, 3)``.
        """
        on_cloth = self._mesh.grid.places
        faces = self._mesh.grid.faces
        in_image, in_texels = (
            np.abs(np.linalg.det(points[faces[:, 1:]] - points[faces[:, :1]]))  # twice the triangles' areas
            for points in (places, on_cloth * texture.shape[::-1])
        )
        fineness = np.sqrt(in_texels / np.maximum(in_image, 1e-6))
        return texture.sample(np.einsum("pk,pkc->pc", shares, on_cloth[faces[face]]), fineness[face])


class Texture:
    """A texture, sampled as in OpenGL: repeated, and linear between texels and between mipmap levels.

    Args:
        picture: Image of shape ``(H, W, 3)``, uint8.
    """

    def __init__(self, picture: NDArray[np.uint8]) -> None:
        self._levels: list[NDArray[Any]] = [picture]
        while max(self._levels[-1].shape[:2]) > 1:
            last = self._levels[-1]
            width, height = (max(side // 2, 1) for side in last.shape[1::-1])
            self._levels.append(cv2.resize(last, (width, height), interpolation=cv2.INTER_AREA))

    @classmethod
    def of(cls, model: Any, material: int) -> Texture | None:
        """Return the texture of a model's material; None if there is no material or no texture."""
        if material < 0:
            return None
        index = int(model.mat_texid[material].max())  # it has one role only
        if index < 0:
            return None
        height, width, start = (int(field[index]) for field in (model.tex_height, model.tex_width, model.tex_adr))
        return cls(model.tex_data[start : start + 3 * height * width].reshape(height, width, 3).copy())

    @property
    def is_white(self) -> bool:
        """Whether the texture leaves colours unchanged."""
        return bool(self._levels[0].min() == 255)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in texels."""
        return self._levels[0].shape[0], self._levels[0].shape[1]

    def sample(self, places: NDArray[Any], fineness: NDArray[Any] | float) -> NDArray[Any]:
        """Sample colours.

        Args:
            places: Coordinates of shape ``(..., 2)``, right and down from the upper left corner, in fractions of the
                texture; any numbers.
            fineness: Texels per pixel, shape (...).

        Returns:
            Colours of shape ``(..., 3)``, float32, 0 ... 1.
        """
        # cv2.remap returns an image, whose sides are limited to 32766: the places are laid out in rows
        count = int(np.prod(np.shape(places)[:-1]))
        padded = np.zeros((-(-count // _ROW) * _ROW, 2), np.float32)
        padded[:count] = np.reshape(places, (-1, 2))
        level = np.zeros(len(padded), np.float32)
        level[:count] = np.broadcast_to(np.log2(np.maximum(fineness, 1e-6)), np.shape(places)[:-1]).ravel()
        at, level = padded.reshape(-1, _ROW, 2), np.clip(level, 0, len(self._levels) - 1).reshape(-1, _ROW, 1)
        out = np.zeros((*at.shape[:2], 3), np.float32)
        for i in range(int(level.min()), int(np.ceil(level.max())) + 1):
            picture = self._levels[i]
            texels = at * np.array(picture.shape[1::-1], np.float32) - np.float32(0.5)
            seen = cv2.remap(picture, texels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)  # type: ignore[call-overload]
            out += np.maximum(1 - np.abs(level - i), 0) * seen
        return (out / np.float32(255)).reshape(-1, 3)[:count].reshape(*np.shape(places)[:-1], 3)


def shade(model: Any, data: Any, rgba: NDArray[Any], normals: Array) -> Array:
    """Return colours ``(M, 3)``, 0 ... 1, of matt surfaces: ambient plus Lambert, as in OpenGL.

    Args:
        model: The MuJoCo model.
        data: Its state.
        rgba: Colours of the surfaces, ``(M, 4)`` or ``(4,)``.
        normals: Unit normals ``(M, 3)``, world frame.
    """
    facing = np.maximum(-normals @ data.light_xdir.T, 0)
    light = model.light_ambient.sum(axis=0) + facing @ model.light_diffuse
    return np.clip(rgba[..., :3] * light, 0, 1)


def to_bytes(colours: Array) -> NDArray[np.uint8]:
    """Convert colours 0 ... 1 to uint8."""
    return np.rint(colours * 255).astype(np.uint8)


def draw_triangles(places: Array, depth: Array, faces: Indices, shape: tuple[int, int]) -> Drawn:
    """Draw triangles as OpenGL does: by pixel centres, the nearest wins, interpolated in space.

    Args:
        places: Pixels of the vertices, ``(V, 2)``, centres at integers.
        depth: Depths of the vertices along the optical axis in metres, ``(V,)``, above 0.
        faces: Vertices of the triangles, ``(F, 3)``, in either orientation.
        shape: Size ``(H, W)`` of the image.
    """
    corners, near = places[faces], 1 / depth[faces]
    edges = _edges(corners)
    area = np.einsum("fk,fk->f", edges[:, 0, :2], corners[:, 0]) + edges[:, 0, 2]
    whole = np.abs(area) > 1e-12  # a triangle seen edge on covers nothing
    edges = edges[whole] / area[whole, None, None]
    face, v, start, count = _spans(corners[whole], edges, shape)
    span = np.repeat(np.arange(len(face)), count)
    u = start[span] + np.arange(len(span)) - np.repeat(np.cumsum(count) - count, count)
    face, v = face[span], v[span]
    # 1/z is linear over the image
    plane = np.einsum("fkc,fk->fc", edges, near[whole])[face]
    inverse = plane[:, 0] * u + plane[:, 1] * v + plane[:, 2]
    pixels = v * shape[1] + u
    nearest = np.zeros(shape[0] * shape[1])
    np.maximum.at(nearest, pixels, inverse)
    wins = np.flatnonzero(inverse == nearest[pixels])
    winner = np.full(len(nearest), -1)
    winner[pixels[wins]] = wins
    pixels = np.flatnonzero(winner >= 0)
    wins = winner[pixels]
    face, inverse = face[wins], inverse[wins]
    flat = np.einsum("pkc,cp->pk", edges[face], np.stack([u[wins], v[wins], np.ones(len(wins))]))
    shares = flat * near[whole][face] / inverse[:, None]
    return Drawn(pixels, np.flatnonzero(whole)[face], shares, 1 / inverse)


def _edges(corners: Array) -> Array:
    """Return lines ``(F, 3, 3)`` opposite to each corner: line . (u, v, 1) is the corner's share times the area."""
    first, second = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    out = np.empty((len(corners), 3, 3))
    out[..., 0] = first[..., 1] - second[..., 1]
    out[..., 1] = second[..., 0] - first[..., 0]
    out[..., 2] = first[..., 0] * second[..., 1] - second[..., 0] * first[..., 1]
    return out


def _spans(corners: Array, edges: Array, shape: tuple[int, int]) -> tuple[Indices, Indices, Indices, Indices]:
    """Return the rows of pixels within triangles: face, row v, first column u, and length."""
    low = np.maximum(np.ceil(corners[..., 1].min(axis=1) - _TOLERANCE), 0).astype(np.int64)
    high = np.minimum(np.floor(corners[..., 1].max(axis=1) + _TOLERANCE), shape[0] - 1).astype(np.int64)
    count = np.maximum(high - low + 1, 0)
    face = np.repeat(np.arange(len(corners)), count)
    v = low[face] + np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    # inside: a u + b v + c >= 0 for each edge
    slope = edges[face, :, 0]
    rest = edges[face, :, 1] * v[:, None] + edges[face, :, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = -rest / slope
    start = np.where(slope > 0, cross, -np.inf).max(axis=1)
    end = np.where(slope < 0, cross, np.inf).min(axis=1)
    start = np.maximum(np.ceil(start - _TOLERANCE), 0)
    end = np.minimum(np.floor(end + _TOLERANCE), shape[1] - 1)
    inside = ((slope != 0) | (rest >= -_TOLERANCE)).all(axis=1) & (end >= start)
    start, end = start[inside].astype(np.int64), end[inside].astype(np.int64)
    return face[inside], v[inside], start, end - start + 1
