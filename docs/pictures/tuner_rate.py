"""Count how often the tuner's page shows a new image: `uv run python docs/pictures/tuner_rate.py`; it needs a Chromium.

A recording of 300 frames of 640 x 480 pixels is played at its own rate, 20 frames a second.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import sync_playwright

from shape_obs import HSVRange, save_config
from shape_obs.recording import record
from shape_obs_envs.sources import open_source

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

from tuner_page import ARGUMENTS, chromium, serving

FRAMES, SECONDS, ROUNDS = 300, 4, 3
BLUE = HSVRange(low=(100, 120, 40), high=(125, 255, 255))
COUNT = """async (seconds) => {
    const image = document.querySelector('.tune-pick img');
    let count = 0;
    const add = () => count++;
    image.addEventListener('load', add);
    await new Promise(resolve => setTimeout(resolve, 1000 * seconds));
    image.removeEventListener('load', add);
    return count / seconds; }"""


def main() -> None:
    with TemporaryDirectory() as folder:
        recording, config = Path(folder) / "cable", Path(folder) / "blue.yaml"
        record(open_source("ShapeObs/Cable-v0", actions="random", seed=0, camera="d455"), recording, frames=FRAMES)
        save_config(config, {"segmentation": BLUE})
        with serving(recording, "--config", config) as served, sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium(playwright), args=list(ARGUMENTS))
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.goto(served.url)
            page.wait_for_function("document.querySelector('.tune-pick img')?.src.startsWith('blob:')")
            for _ in range(ROUNDS):
                rate = page.evaluate(COUNT, SECONDS)
                print(f"{rate:.1f} images/s in the browser, load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
            browser.close()


if __name__ == "__main__":
    main()
