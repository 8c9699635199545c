"""``shape-obs demo``: run an episode of the simulated cable through the wrapper."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from shape_obs.cli.outputs import Overwrite, check_outputs, note_output
from shape_obs.cli.parsing import Option, parse
from shape_obs.cli.rerun_option import TARGET, check_target, open_rerun, rerun_file, with_rerun_value

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from shape_obs.drawing import Image, RerunLog
    from shape_obs.shape import Detection

_PAUSE = 20  # repetitions of the last frame
_MARGIN = 40  # pixels of an image 640 pixels wide, around everything that moves in it
_WIDTH = 640  # pixels of a panel, about
_LEGEND = 48  # pixels of the band with title and legend, at size 1


@dataclass(frozen=True)
class Arguments:
    """Run an episode of the simulated cable through the shape wrapper and draw the detected points."""

    out: Annotated[Path, Option("FOLDER", "output")] = Path("demo")
    """Folder for the picture and the animation."""
    steps: Annotated[int, Option("N", "episode", least=1, most=50)] = 50
    """Number of steps, at most 50."""
    seed: Annotated[int, Option("N", "episode", least=0)] = 0
    """Seed of the start, the goal and the motion."""
    camera: Annotated[Literal["d455", "rl"], Option(group="camera")] = "d455"
    """The simulated camera: 640 x 480 or 160 x 120."""
    renderer: Annotated[Literal["auto", "gl", "rays"], Option(group="camera")] = "auto"
    """OpenGL, ray casting, or 'auto': OpenGL where available, else ray casting."""
    rerun: Annotated[str | None, Option(TARGET, "output", check=check_target)] = None
    """Log the episode to rerun: to FILE.rrd, or to a running viewer by its address. Without a value, open the viewer,
    or write OUT/demo.rrd if there is no display (needs the extra 'rerun')."""
    overwrite: Overwrite = False
    """Replace existing files; unchanged files of earlier runs are replaced in any case."""


@dataclass(frozen=True)
class Shown:
    """What is drawn of one frame: the image, the shape, and the goal as ``(N, 2)`` pixels."""

    picture: Image
    detection: Detection
    goal: npt.NDArray[np.float64]


@dataclass
class Record:
    """Frames and measurements of an episode."""

    shown: list[Shown]
    vectors: list[npt.NDArray[np.float32]]
    errors_mm: list[float]
    errors_px: list[float]
    latencies_ms: list[float]
    goal_distances_mm: list[float]
    flips: int = 0
    lost: int = 0


def main(argv: Sequence[str]) -> int:
    """Run the command and return the exit code."""
    args = parse(Arguments, with_rerun_value(argv), "shape-obs demo")
    files = [args.out / "demo.png", args.out / "demo.gif"]
    logged = rerun_file(args.rerun, args.out / "demo")
    check_outputs(args, *files, logged)
    import numpy as np

    from shape_obs.utils.arrays import write_gif, write_image
    from shape_obs.utils.files import make_folder

    make_folder(args.out)
    if args.rerun is None:
        record = run_episode(args)
    else:
        from shape_obs.drawing import RerunLog

        with open_rerun(args.rerun, args.out / "demo", "shape-obs demo") as stream:
            record = run_episode(args, RerunLog(stream.recording))
    large = draw_frames(record, [0, len(record.shown) - 1], size=2.0)
    gap = np.full((len(large[0]), 8, 3), 255, np.uint8)
    write_image(files[0], np.concatenate([large[0], gap, large[-1]], axis=1))
    frames = draw_frames(record, range(len(record.shown)), size=1.5)
    write_gif(files[1], frames + frames[-1:] * _PAUSE, 0.05)
    print(summary(record))
    for path in (*files, *([logged] if logged is not None and logged.parent == args.out else [])):
        note_output(path)
    print(f"pictures        {files[0]}, {files[1]}")
    return 0


def run_episode(args: Arguments, log: RerunLog | None = None) -> Record:
    """Play the motion that leads to the goal of the episode, and detect the cable in every frame."""
    import gymnasium as gym
    import numpy as np
    from tqdm import tqdm

    from shape_obs.wrappers import ShapeObservation

    cable = "shape_obs_envs:ShapeObs/Cable-v0"
    env = ShapeObservation(gym.make(cable, camera=args.camera, renderer=args.renderer, render_mode="rgbd_tuple"))
    simulator: Any = env.unwrapped
    record = Record([], [], [], [], [], [])
    try:
        observation, info = env.reset(seed=args.seed)
        actions = list(simulator.goal_actions)
        for step in tqdm(range(args.steps), unit="step", leave=False):
            action = actions[step] if step < len(actions) else np.zeros(6, np.float32)
            observation, _, _, _, info = env.step(action)
            _remember(record, env, observation, info, log)
    finally:
        env.close()
    return record


def summary(record: Record) -> str:
    """Return the lines that the demo prints."""
    import numpy as np

    first = record.vectors[0].reshape(-1, 3)
    rows = [f"  point {i:2d}        x {x:+.4f}  y {y:+.4f}  z {z:+.4f} m" for i, (x, y, z) in enumerate(first[:4])]
    return "\n".join(
        [
            f"observation     {len(record.vectors[0])} numbers: {len(first)} points on the cable's axis, base frame",
            *rows,
            "  ...",
            f"frames          {len(record.vectors)}, not ok: {record.lost}, order reversed: {record.flips}",
            f"ms per frame    {np.median(record.latencies_ms):.2f} median, "
            f"{np.percentile(record.latencies_ms, 95):.2f} 95th percentile (image to vector)",
            f"error           {np.mean(record.errors_mm):.2f} mm mean, {np.max(record.errors_mm):.2f} mm worst frame; "
            f"{np.mean(record.errors_px):.2f} px mean (against the simulator)",
            f"goal            {record.goal_distances_mm[0]:.1f} mm away at the start, "
            f"{record.goal_distances_mm[-1]:.1f} mm at the end (measured by the camera)",
        ]
    )


def _remember(
    record: Record, env: Any, observation: dict[str, Any], info: dict[str, Any], log: RerunLog | None
) -> None:
    """Add one frame and its measurements to the record."""
    import numpy as np

    from shape_obs.drawing.matching_pixels import matching_pixels
    from shape_obs.frame import Frame

    detection: Detection = env.detection
    shape = detection.shapes[0]
    simulator = env.unwrapped
    truth = simulator.truth(n=len(shape), frame="world")
    found = observation["achieved_goal"].reshape(-1, 3)
    forward = np.linalg.norm(found - truth, axis=1).mean()
    record.flips += bool(np.linalg.norm(found[::-1] - truth, axis=1).mean() < forward)
    record.lost += not info["shape/ok"]
    record.errors_mm.append(1e3 * float(forward))
    pixels = simulator.truth(n=len(shape), frame="pixels", surface=True)
    record.errors_px.append(float(np.linalg.norm(shape.points2d - pixels, axis=1).mean()))
    record.latencies_ms.append(detection.timings["total"])
    goal = observation["desired_goal"].reshape(-1, 3)
    record.goal_distances_mm.append(1e3 * float(np.linalg.norm(found - goal, axis=1).mean()))
    record.vectors.append(observation["observation"])
    picture, depth = env.render()
    goal_pixels = simulator.camera_model.project_from_base(goal)
    if log is not None:
        log.log(
            detection,
            picture,
            depth,
            simulator.camera_model,
            mask=matching_pixels(Frame(picture, depth), env.detector),
            features=env.named_features(observation["observation"]),
            goals=[goal_pixels],
        )
    record.shown.append(Shown(picture, detection, goal_pixels))


def draw_frames(record: Record, steps: Iterable[int], size: float) -> list[Image]:
    """Draw frames, cropped to where the cable and the goal are in any frame, under their distance and a legend.

    Args:
        record: The episode.
        steps: The numbers of the frames to draw, from 0.
        size: Enlarges points, lines and text.
    """
    import numpy as np

    from shape_obs.drawing import GOAL, draw_detection

    left, top, right, bottom = _window(record.shown)
    scale = max(1, round(_WIDTH / (right - left)))
    hidden = any(not shown.detection.shapes[0].valid.all() for shown in record.shown)
    frames = []
    for step in steps:
        shown = record.shown[step]
        under = [(shown.goal, GOAL)]
        canvas = draw_detection(shown.picture, shown.detection, scale=scale, size=size, under=under)
        canvas = canvas[top * scale : bottom * scale, left * scale : right * scale]
        title = f"Step {step + 1}: {record.goal_distances_mm[step]:.1f} mm from the goal"
        frames.append(np.concatenate([_heading(title, canvas.shape[1], size, hidden=hidden), canvas]))
    return frames


def _window(frames: Sequence[Shown]) -> tuple[int, int, int, int]:
    """Return left, top, right and bottom of what is shown of the pictures."""
    import numpy as np

    places = [points for each in frames for points in (each.goal, each.detection.shapes[0].pixels)]
    points = np.concatenate(places)
    height, width = frames[0].picture.shape[:2]
    margin = _MARGIN * width // 640
    low, high = np.nanmin(points, axis=0) - margin, np.nanmax(points, axis=0) + margin
    left, top = (max(int(edge), 0) for edge in low)
    return left, top, min(int(high[0]), width), min(int(high[1]), height)


def _heading(title: str, width: int, size: float, *, hidden: bool) -> Image:
    """Return a band with a title and the legend."""
    import numpy as np

    from shape_obs.drawing import GOAL, HIDDEN, VALID, draw_curve, draw_point, draw_text, text_width

    band = np.full((round(_LEGEND * size), width, 3), 255, np.uint8)
    draw_text(band, title, (round(7 * size), round(17 * size)), size=size)
    at, middle = 12 * size, 36 * size
    for name, colour in (("detected point", VALID), *([("hidden point", HIDDEN)] if hidden else [])):
        draw_point(band, np.array([at, middle]), colour, size=size)
        draw_text(band, name, (round(at + 10 * size), round(middle + 4 * size)), size=size)
        at += 32 * size + text_width(name, size)
    draw_curve(band, np.array([[at - 7 * size, middle], [at + 9 * size, middle]]), GOAL, thickness=round(4 * size))
    draw_text(band, "goal", (round(at + 15 * size), round(middle + 4 * size)), size=size)
    return band
