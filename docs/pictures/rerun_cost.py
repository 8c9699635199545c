"""Measure what `log_rerun` costs next to `detect`, and fill the table of `docs/how-to/show-in-rerun.md`.

Run: `uv run python docs/pictures/rerun_cost.py`

The picture of that page is a screenshot of the viewer, on a machine with Vulkan, if only in software under Xvfb:
`shape-obs demo --rerun demo.rrd; rerun demo.rrd --screenshot-to rerun.png --window-size 1280x800`.
"""

import re
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from rerun.recording_stream import RecordingStream

import shape_obs
from shape_obs import Centerline, HSVRange, ShapeDetector
from shape_obs.drawing.matching_pixels import matching_pixels
from shape_obs.recording.format import read_moments
from shape_obs_envs.sources import open_source

PAGE = Path(__file__).parents[1] / "how-to" / "show-in-rerun.md"
FRAMES, ROUNDS = 40, 5
BLUE = HSVRange(low=(100, 120, 40), high=(125, 255, 255))


def main() -> None:
    with open_source("ShapeObs/Cable-v0", actions="random", seed=0, camera="d455") as source:
        frames = [moment.frame for moment in read_moments(source, FRAMES)]
    detector = ShapeDetector([Centerline(n=20, ends="tips")], BLUE)
    times: dict[str, list[float]] = defaultdict(list)
    size = 0.0
    images: dict[str, Any]
    for _ in range(ROUNDS):
        with tempfile.TemporaryDirectory() as folder:
            recording: Any = RecordingStream("costs")
            recording.save(f"{folder}/costs.rrd")
            for number, frame in enumerate(frames):
                mask = matching_pixels(frame, detector)
                begin = time.perf_counter()
                detection = detector.detect(frame.rgb, frame.depth, frame.camera, stamp=number / 30)
                times["`detect`"].append(time.perf_counter() - begin)
                for name, images in (
                    ("`log_rerun` of the shape alone", {}),
                    ("with the image", {"rgb": frame.rgb}),
                    ("with image, depth, camera and mask",
                     {"rgb": frame.rgb, "depth": frame.depth, "camera": frame.camera, "mask": mask}),
                ):  # fmt: skip
                    begin = time.perf_counter()
                    shape_obs.log_rerun(detection, recording=recording, number=number, **images)
                    times[name].append(time.perf_counter() - begin)
            recording.disconnect()
            size = Path(f"{folder}/costs.rrd").stat().st_size / len(frames)
    lines = ["| Per frame of 640 × 480 | Median [ms] | 95th percentile [ms] |", "|---|---|---|"]
    for name, values in times.items():
        half, most = 1e3 * np.percentile(values, [50, 95])
        lines.append(f"| {name} | {half:.1f} | {most:.1f} |")
    print("\n".join(lines), f"\n{size / 1e3:.0f} kB per frame, all three")
    table = "\n".join(["<!-- costs -->", *lines, "<!-- end -->"])
    text = re.sub(r"<!-- costs -->.*?<!-- end -->", lambda _: table, PAGE.read_text(encoding="utf-8"), flags=re.S)
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
