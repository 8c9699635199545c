"""Draw the pictures of the page on the tuner: `uv run python docs/pictures/tuner.py`; it needs a Chromium."""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from playwright.sync_api import Page, expect, sync_playwright

from shape_obs.bench.scenes import draw_rope

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
sys.path.insert(0, str(ROOT / "tests" / "support"))

from tuner_page import ARGUMENTS, chromium, serving  # noqa: E402

SIZE = (480, 640)
LENS = (600, 600, 319.5, 239.5)
TABLE, ROPE = 620, 14  # millimetres from the camera, and above the table


def write_photo(folder: Path) -> tuple[Path, Path]:
    """Write a photo of an orange cable on a wooden table, in uneven light, and its depth."""
    rng = np.random.default_rng(3)
    u = np.linspace(70, 570, 900)
    curve = np.stack([u, 235 + 105 * np.sin((u - 70) / 95) + 25 * np.sin((u - 70) / 37)], axis=1)
    mask = draw_rope(curve, 15.0, size=SIZE).mask
    grain = cv2.GaussianBlur(rng.normal(0, 40, SIZE), (0, 0), sigmaX=40, sigmaY=0.8)
    scene = np.array([168.0, 142, 112]) + grain[..., None] * 2.2
    shadow = cv2.GaussianBlur(np.roll(mask, (9, 7), axis=(0, 1)), (0, 0), 5)[..., None] / 255
    scene *= 1 - 0.35 * shadow
    depth = cv2.distanceTransform(mask, cv2.DIST_L2, 5)
    shading = 0.65 + 0.35 * np.clip(depth / 7.5, 0, 1)
    soft = cv2.GaussianBlur(mask, (0, 0), 0.8)[..., None] / 255
    scene = scene * (1 - soft) + np.array([232.0, 104, 22]) * shading[..., None] * soft
    light = np.linspace(1.12, 0.82, SIZE[1])[None, :, None]
    photo = np.clip(scene * light + rng.normal(0, 3, (*SIZE, 3)), 0, 255).astype(np.uint8)
    cv2.imwrite(str(folder / "cable.png"), cv2.cvtColor(photo, cv2.COLOR_RGB2BGR))
    metres = TABLE - ROPE * np.sqrt(np.clip(depth / 7.5, 0, 1)) + rng.normal(0, 0.6, SIZE)
    cv2.imwrite(str(folder / "cable_depth.png"), metres.round().astype(np.uint16))
    return folder / "cable.png", folder / "cable_depth.png"


def click(page: Page, u: float, v: float) -> None:
    """Click at a pixel of the photo."""
    image = page.locator(".tune-pick img")
    box = image.bounding_box()
    assert box is not None
    image.click(position={"x": u / SIZE[1] * box["width"], "y": v / SIZE[0] * box["height"]})


def shoot(page: Page, name: str) -> None:
    """Write a picture of what the page shows, once it is quiet."""
    page.mouse.move(0, 0)
    page.wait_for_timeout(2500)
    page.screenshot(path=IMAGES / name, type="jpeg", quality=88)


def main() -> None:
    with TemporaryDirectory() as place, sync_playwright() as playwright:
        photo, depth = write_photo(Path(place))
        browser = playwright.chromium.launch(executable_path=chromium(playwright), args=list(ARGUMENTS))
        with serving(photo, "--depth", depth, "--intrinsics", *LENS, "--save", Path(place) / "shape.yaml") as served:
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.goto(served.url)
            page.wait_for_function("document.querySelector('.tune-pick img').src.startsWith('blob:')")
            click(page, 160, 339)
            expect(page.locator(".found")).to_contain_text("20 points", timeout=60_000)
            shoot(page, "tune_laptop.jpg")
            page.set_viewport_size({"width": 1440, "height": 1290})
            page.locator(".tune-below").screenshot(path=IMAGES / "tune_stages.jpg", type="jpeg", quality=88)
            page.get_by_role("tab", name="3D").click()
            expect(page.locator(".nicegui-scene canvas")).to_be_visible(timeout=60_000)
            page.wait_for_timeout(4000)
            page.locator(".tune-below").screenshot(path=IMAGES / "tune_3d.jpg", type="jpeg", quality=88)
            phone = browser.new_page(viewport={"width": 390, "height": 844}, device_scale_factor=2)
            phone.goto(served.url)
            expect(phone.locator(".found")).to_contain_text("20 points", timeout=60_000)
            shoot(phone, "tune_phone.jpg")
        browser.close()


if __name__ == "__main__":
    main()
