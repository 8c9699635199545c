"""The page in a real browser: from a click to a file that every command reads."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from installed import needs
from tuner_page import ARGUMENTS, chromium, serving

from shape_obs import load_config
from shape_obs.bench.scenes import draw_rope
from shape_obs.cli import main

pytestmark = needs("nicegui", "playwright")

REAL = Path(__file__).parents[3] / "shared" / "data" / "real" / "blue_rope_640x480.png"
CAMERA = Path(__file__).parents[1] / "support" / "tuner_camera.py"
LAPTOP, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
PATIENCE = 60_000  # milliseconds: the machine may be busy
BLUE = {"kind": "hsv", "low": [100, 120, 40], "high": [130, 255, 255]}


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        path = chromium(playwright)
        if path is None:
            pytest.skip("no Chromium: neither on the PATH nor installed by Playwright")
        started = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        yield started
        started.close()


@pytest.fixture
def drawn(tmp_path) -> Path:
    """Return a photo of a drawn blue rope on gray, 640 x 480 pixels."""
    u = np.linspace(80, 560, 800)
    mask = draw_rope(np.stack([u, 240 + 90 * np.sin((u - 80) / 80)], axis=1), 16.0, size=(480, 640)).mask
    rgb = np.where(mask[..., None] > 0, np.array([30, 60, 200]), np.array([150, 150, 150])).astype(np.float64)
    noisy = np.clip(rgb + np.random.default_rng(0).normal(0, 4, rgb.shape), 0, 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "rope.png"), cv2.cvtColor(noisy, cv2.COLOR_RGB2BGR))
    return tmp_path / "rope.png"


def expect(locator):
    """Return Playwright's assertions of a locator; collecting the tests does not load it."""
    from playwright import sync_api

    return sync_api.expect(locator)


def opened(browser, url, size=LAPTOP):
    page = browser.new_page(viewport=size)
    page.set_default_timeout(PATIENCE)
    page.goto(url)
    image = page.locator(".tune-pick img")
    expect(image).to_be_visible(timeout=PATIENCE)
    page.wait_for_function("document.querySelector('.tune-pick img').src.startsWith('blob:')")
    return page


def click_at(page, u, v, size=(640, 480), **options):
    """Click at a pixel of the image."""
    image = page.locator(".tune-pick img")
    box = image.bounding_box()
    place = {"x": (u + 0.5) / size[0] * box["width"], "y": (v + 0.5) / size[1] * box["height"]}
    image.click(position=place, **options)


def press(slider, key):
    """Press a key on a slider."""
    slider.locator("[tabindex]").press(key)


def expect_text(page, selector, text):
    expect(page.locator(selector).first).to_contain_text(text, timeout=PATIENCE)


def detected(capsys, photo, config, out):
    """Return the points that ``shape-obs detect`` prints."""
    with pytest.raises(SystemExit) as stop:
        main(["detect", str(photo), "--config", str(config), "--out", str(out)])
    assert stop.value.code == 0
    return np.array(json.loads(capsys.readouterr().out)["shapes"][0]["points2d"])


@pytest.mark.parametrize("which", ["drawn", pytest.param("real", marks=pytest.mark.nightly)])
def test_from_a_click_to_a_file_that_gives_the_same_points(browser, which, drawn, tmp_path, capsys):
    photo, pixel = (drawn, (205, 330)) if which == "drawn" else (REAL, (60, 196))
    if not photo.exists():
        pytest.skip(f"the shared data is not there: {photo}")
    with serving(photo, "--save", tmp_path / "shape.yaml") as served:
        page = opened(browser, served.url)
        expect_text(page, ".found", "Click on the object")
        click_at(page, *pixel)
        expect_text(page, ".found", "20 points, all visible")

        for _ in range(5):
            press(page.get_by_role("slider", name="Points N"), "ArrowRight")
        # A busy machine may drop a key that is pressed while the page is drawn again.
        expect(page.locator(".found").first).to_contain_text(re.compile("2[1-5] points"), timeout=PATIENCE)
        page.get_by_role("button", name="Undo").click()
        expect_text(page, ".found", "20 points, all visible")

        slider = page.get_by_role("slider", name="Strictness")
        before = float(slider.get_attribute("aria-valuenow"))
        press(slider, "ArrowLeft")
        expect(slider).not_to_have_attribute("aria-valuenow", f"{before:g}", timeout=PATIENCE)
        page.get_by_role("tab", name="Points").click()
        expect(page.locator(".points tbody tr")).to_have_count(20, timeout=PATIENCE)
        cells = page.locator(".points tbody tr").all_inner_texts()
        shown = np.array([row.split("\t")[2:4] for row in cells], float)

        page.get_by_role("button", name="Save").click()
        expect_text(page, ".q-dialog", "Saved")
    config = load_config(tmp_path / "shape.yaml")
    assert config["segmentation"]["strictness"] == pytest.approx(before - 0.1, abs=0.06)
    np.testing.assert_allclose(detected(capsys, photo, tmp_path / "shape.yaml", tmp_path / "o"), shown, atol=0.06)


@pytest.mark.nightly
def test_a_phone_and_a_laptop_show_the_same_within_their_width(browser, drawn, tmp_path):
    cv2.imwrite(str(tmp_path / "depth.png"), np.full((480, 640), 600, np.uint16))
    with serving(drawn, "--depth", tmp_path / "depth.png", "--intrinsics", 600, 600, 319.5, 239.5) as served:
        phone, laptop = opened(browser, served.url, PHONE), opened(browser, served.url)
        click_at(phone, 205, 330)
        expect_text(laptop, ".found", "20 points")
        press(laptop.get_by_role("slider", name="Points N"), "ArrowRight")
        expect_text(phone, ".found", "21 points")
        assert phone.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        phone.get_by_role("button", name="Not the object").click()
        click_at(phone, 20, 20)
        expect_text(phone, ".proposal + button", "Clear 2 clicks")
        laptop.get_by_role("tab", name="3D").click()
        expect(laptop.locator(".nicegui-scene canvas")).to_be_visible(timeout=PATIENCE)
        laptop.get_by_role("tab", name="Points").click()
        expect(laptop.locator(".points tbody tr").first).to_contain_text("0.600", timeout=PATIENCE)


def test_a_camera_that_is_unplugged_and_a_page_that_is_closed(browser, tmp_path):
    plug = tmp_path / "plug"
    with serving(plug, script=CAMERA) as served:
        page = opened(browser, served.url)
        expect_text(page, ".q-badge", "camera lost")
        expect_text(page, ".reason", "The camera is gone")
        plug.touch()
        expect_text(page, ".q-badge", "live")
        expect_text(page, ".found", "20 points")
        page.close()
        log, end = plug.with_suffix(".log"), time.monotonic() + 60
        while log.read_text().splitlines()[-1] != "disconnect":
            assert time.monotonic() < end
            time.sleep(0.1)
        page = opened(browser, served.url)
        expect_text(page, ".q-badge", "live")
    assert log.read_text().splitlines()[-1] == "disconnect"
