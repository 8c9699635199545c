"""The pictures of 'How a shape is found': uv run python docs/pictures/stages.py."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.distance import cdist
from sheet import grid, save, titled

from shape_obs import Centerline, Configuration, Contour, HSVRange, ShapeDetector, Surface
from shape_obs.bench.scenes import draw_rope
from shape_obs.drawing import draw_curve, draw_detection
from shape_obs.frame import Frame
from shape_obs.geometry.curve import FittedCurve, FittedForm
from shape_obs.geometry.lattice import FittedLattice
from shape_obs.geometry.observed import Samples
from shape_obs.geometry.outline import SAMPLED, pairs
from shape_obs.geometry.topology import Topology
from shape_obs.image.find_region import find_region
from shape_obs.image.region import Region
from shape_obs.image.roi import Whole
from shape_obs.initialization.medial_axis import medial_axis
from shape_obs.tracking.clock import Clock
from shape_obs.tracking.scene import Scene

IMAGES = Path(__file__).parent.parent / "images"
SIZE = (240, 320)
SCALE = 2
CELL = 6  # pixels
BLUE, ORANGE, GREEN = (45, 85, 200), (225, 120, 40), (60, 150, 80)
PALE, PAPER = (205, 215, 230), (250, 250, 250)
INK, START, NODE = (30, 30, 30), (0, 125, 115), (210, 40, 160)
LETTERS = 20  # pixels of a sheet 1290 pixels wide
RULES = {
    "centerline": HSVRange(low=(100, 80, 40), high=(125, 255, 255)),
    "contour": HSVRange(low=(5, 120, 60), high=(20, 255, 255)),
    "surface": HSVRange(low=(50, 80, 40), high=(80, 255, 255)),
}


def rope() -> np.ndarray:
    """A bent rope."""
    u = np.linspace(35, 285, 500)
    return draw_rope(np.stack([u, 120 + 55 * np.sin((u - 35) / 48)], axis=1), 13.0, size=SIZE).mask


def ring() -> np.ndarray:
    """A dented elastic band lying flat."""
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radius = 75 + 16 * np.cos(2 * angle + 0.6) - 14 * np.cos(3 * angle)
    outline = np.stack([160 + 1.25 * radius * np.cos(angle), 120 + radius * np.sin(angle)], axis=1)
    return cv2.fillPoly(np.zeros(SIZE, np.uint8), [np.rint(outline * 16).astype(np.int32)], 255, shift=4)


def cloth() -> np.ndarray:
    """A towel, pulled a little out of shape."""
    t = np.linspace(0, 1, 60)[:, None]
    corners = np.array([[75.0, 40], [275, 70], [255, 205], [45, 190]])
    sides = []
    for start, end, bulge in zip(corners, np.roll(corners, -1, axis=0), (9, -8, 10, 7), strict=True):
        normal = np.array([(end - start)[1], -(end - start)[0]]) / np.linalg.norm(end - start)
        sides.append(start + t * (end - start) + bulge * np.sin(np.pi * t) * normal)
    outline = np.rint(np.concatenate(sides) * 16).astype(np.int32)
    return cv2.fillPoly(np.zeros(SIZE, np.uint8), [outline], 255, shift=4)


def photograph(masks: dict[str, np.ndarray], seed: int = 0) -> np.ndarray:
    """Coloured things on a gray table, with uneven light and noise: (H,W,3) uint8, RGB."""
    rng = np.random.default_rng(seed)
    height, width = next(iter(masks.values())).shape
    scene = np.full((height, width, 3), (165.0, 162, 155))
    for name, colour in zip(RULES, (BLUE, ORANGE, GREEN), strict=True):
        if name in masks:
            soft = cv2.GaussianBlur(masks[name], (0, 0), 0.7)[..., None] / 255.0
            scene = scene * (1 - soft) + np.array(colour) * soft
    light = np.linspace(1.08, 0.85, width)[None, :, None] * np.linspace(1.03, 0.95, height)[:, None, None]
    return np.clip(scene * light + rng.normal(0, 5, scene.shape), 0, 255).astype(np.uint8)


def stages(spec: Configuration, mask: np.ndarray) -> np.ndarray:
    """Six panels: the image, the mask in cells, the cold start, the map's nodes, the form, the points."""
    image = photograph({spec.kind: mask})
    rule = RULES[spec.kind]
    window = Whole().window(SIZE)
    region = find_region(rule.apply(Frame(image, None, None, None), window), window, rule.min_area, rule.min_share)
    found = spec.fit(region, None, None, Scene.in_image(Frame(), Clock(), SIZE, window))
    assert found.track is not None
    nodes, topology = found.track.nodes, found.track.topology
    start = initial_form(spec, region, found.form)
    path = [nodes]
    if start is not found.form:
        path.insert(0, start.points[cdist(nodes, start.points).argmin(axis=1)])
    detection = ShapeDetector([spec], rule).detect(image)
    pale = np.where(region.mask[..., None] > 0, PALE, PAPER).astype(np.uint8)
    panels = {
        "1  image": enlarged(image),
        "2  mask, as weighted samples": samples(SAMPLES[spec.kind](region), region),
        f"3  cold start: {COLD[spec.kind]}": with_form(pale, start),
        f"4  {MAP[spec.kind]}, {len(nodes)} nodes": with_nodes(pale, path, topology),
        "5  the form through the nodes": with_form(pale, found.form),
        f"6  {spec.layout.size} ordered points, quality {detection.shapes[0].quality:.2f}": draw_detection(
            image, detection, scale=SCALE, size=1.6
        ),
    }
    return grid([titled(panel, title, LETTERS) for title, panel in panels.items()], 2)


MAP = {
    "centerline": "self-organising map",
    "contour": "self-organising map",
    "surface": "what the track stores",
}
COLD = {"centerline": "the outline, folded", "contour": "the outline", "surface": "corners and a Coons patch"}
SAMPLES = {
    "centerline": lambda region: region.gather(max(region.width / 3, 1)),
    "contour": lambda region: in_twos(region.outline.points),
    "surface": lambda region: region.gather(CELL),
}


def in_twos(points: np.ndarray) -> Samples:
    """The points of an outline, two by two."""
    weight = np.full((len(points) + 1) // SAMPLED, float(SAMPLED))
    weight[-1] -= len(points) % SAMPLED
    return Samples(pairs(points), weight, float(SAMPLED))


def initial_form(spec: Configuration, region: Region, found: FittedForm) -> FittedForm:
    """The form from which the fit starts; a sheet's is the patch itself."""
    if isinstance(spec, Centerline):
        return medial_axis(region)
    return region.outline_curve() if isinstance(spec, Contour) else found


def enlarged(image: np.ndarray) -> np.ndarray:
    """The picture at the size of a panel."""
    return np.repeat(np.repeat(image, SCALE, axis=0), SCALE, axis=1)


def place(points: np.ndarray) -> np.ndarray:
    """Pixels of the image as pixels of a panel."""
    return (points + 0.5) * SCALE - 0.5


def samples(found: Samples, region: Region) -> np.ndarray:
    """Each sample as a dot as large as its weight."""
    picture = enlarged(np.where(region.mask[..., None] > 0, PALE, PAPER).astype(np.uint8))
    for point, weight in zip(place(found.points), found.weight, strict=True):
        radius = max(0.35 * SCALE * weight**0.5, 1.5)
        cv2.circle(picture, np.rint(point * 16).astype(int).tolist(), round(radius * 16), BLUE, -1, cv2.LINE_AA, 4)
    return picture


def with_form(pale: np.ndarray, form: FittedForm) -> np.ndarray:
    """A curve as a line, a patch as a mesh."""
    picture = enlarged(pale)
    if isinstance(form, FittedLattice):
        lattice = place(form.lattice)
        for line in (*lattice, *lattice.swapaxes(0, 1)):
            draw_curve(picture, line, START, thickness=2)
    else:
        assert isinstance(form, FittedCurve)
        points = np.concatenate([form.points, form.points[:1]]) if form.closed else form.points
        draw_curve(picture, place(points), START, thickness=4)
    return picture


def with_nodes(pale: np.ndarray, path: list[np.ndarray], topology: Topology) -> np.ndarray:
    """The nodes at the end, and from which place of the initial form each came."""
    picture = enlarged(pale)
    for first, second in topology.edges():
        draw_curve(picture, place(path[-1][[first, second]]), (120, 130, 150), thickness=1)
    for node in range(len(path[0])):
        draw_curve(picture, place(np.stack([nodes[node] for nodes in path])), START, thickness=2)
        cv2.circle(picture, np.rint(place(path[-1][node]) * 16).astype(int).tolist(), 56, NODE, -1, cv2.LINE_AA, 4)
    return picture


def together() -> np.ndarray:
    """Three shapes of three colours in one pass."""
    canvas = {}
    for name, mask, (left, top) in (
        ("centerline", rope(), (0, 0)),
        ("contour", ring(), (320, 0)),
        ("surface", cloth(), (150, 230)),
    ):
        whole = np.zeros((480, 640), np.uint8)
        whole[top : top + SIZE[0], left : left + SIZE[1]] = mask
        canvas[name] = whole
    image = photograph(canvas)
    shapes = [
        Centerline(n=20, segmentation=RULES["centerline"]),
        Contour(n=32, segmentation=RULES["contour"]),
        Surface(rows=4, cols=8, segmentation=RULES["surface"]),
    ]
    return draw_detection(image, ShapeDetector(shapes).detect(image))


def write(name: str, picture: np.ndarray) -> None:
    """Write a picture of the docs."""
    save(IMAGES / name, picture)


if __name__ == "__main__":
    write("stages_centerline.jpg", stages(Centerline(n=20), rope()))
    write("stages_contour.jpg", stages(Contour(n=32), ring()))
    write("stages_surface.jpg", stages(Surface(rows=4, cols=8), cloth()))
    write("three_shapes.jpg", together())
