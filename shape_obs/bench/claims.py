"""Every measurement of the accuracy that the project claims, group by group, as tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import numpy as np

from shape_obs.bench import cloud_claims, contour_claims, deploy_claims, env_claims, marker_claims, surface_claims
from shape_obs.bench import env_physics as env_goals
from shape_obs.bench import registration_claims as registration
from shape_obs.bench import rope_claims as claims
from shape_obs.bench import rope_claims as hard_claims
from shape_obs.bench.env_speed import ENVS, Env
from shape_obs.bench.growth import shared_passes
from shape_obs.bench.robustness import bundles, files, inputs, killed_studies, stops
from shape_obs.bench.synthetic.blobs import garments
from shape_obs.bench.tangle_claims import tangled_ropes

Rows = list[dict[str, Any]]
Tables = Iterator[tuple[str, Rows]]


class Effort(NamedTuple):
    """How much to measure.

    Args:
        share: Of the full counts; 1 is the full run.
        seed: Of everything drawn.
        renderer: The simulator's camera.
        garments: A file of annotated garment outlines; None leaves them out.
        jobs: Processes for what takes long.
        told: Called with how far a long group is.
    """

    share: float
    seed: int
    renderer: str
    garments: Path | None
    jobs: int = 1
    told: Callable[[str], object] = lambda text: None

    def count(self, full: int) -> int:
        """A share of a full count, at least one."""
        return max(round(full * self.share), 1)

    def seeds(self, full: int) -> range:
        """As many seeds."""
        return range(self.seed, self.seed + self.count(full))


def _ropes(effort: Effort) -> Tables:
    yield "drawn ropes, cold", claims.rope_table(claims.drawn_ropes(effort.count(40), effort.seed))
    yield "moving ropes, tracked", _rows(claims.moving_ropes((10, 40), effort.seeds(6)))
    yield "ropes at rest in masks that flicker", _rows(hard_claims.flickering_ropes(effort.count(4), effort.seed))


def _tangles(effort: Effort) -> Tables:
    title = "ropes that cross themselves, are cut, or touch themselves, cold"
    yield title, _rows(tangled_ropes(effort.count(100), effort.seed))


def _hands(effort: Effort) -> Tables:
    yield "moving ropes under a hand", _rows(hard_claims.ropes_under_hands(effort.seeds(3)))
    middle = hard_claims.ropes_under_hands(effort.seeds(3), places=("middle",))
    yield "moving ropes under a hand, in the middle", _rows(middle)


def _noise(effort: Effort) -> Tables:
    yield "drawn ropes in noise, cold", _rows(hard_claims.ropes_in_noise(effort.count(12), effort.seed))


def _outlines(effort: Effort) -> Tables:
    blobs = list(contour_claims.drawn_blobs(effort.count(8), effort.seed))
    yield "drawn outlines, cold", contour_claims.outline_table(contour_claims.outlines(blobs))
    if effort.garments is not None:
        drawn = garments(effort.garments)
        yield "garments, cold", contour_claims.outline_table(contour_claims.outlines(drawn))
    yield "turning outlines, tracked", _rows(contour_claims.turning_blobs(seeds=effort.seeds(2)))
    yield (
        "outlines at rest in masks that flicker",
        _rows(contour_claims.flickering_blobs(blobs[:: len(blobs) // 4 or 1])),
    )


def _sheets(effort: Effort) -> Tables:
    drawn = surface_claims.drawn_sheets(effort.count(48), effort.seed)
    yield "drawn sheets, cold", surface_claims.sheet_table(drawn)
    yield "sheets that turn once around, in steps of a degree", _rows(surface_claims.turning_sheets(effort.seeds(6)))
    yield "sheets that wander, turn and bend, tracked", _rows(surface_claims.moving_sheets((12,), effort.seeds(6)))
    yield "sheets at rest in masks that flicker", _rows(surface_claims.noisy_sheets(effort.seeds(6)))


def _clouds(effort: Effort) -> Tables:
    count, seed = effort.count(30), effort.seed
    found = [*cloud_claims.rope_clouds(count, seed), *cloud_claims.ring_clouds(count, seed)]
    found += cloud_claims.sheet_clouds(count, seed)
    yield "clouds, cold", cloud_claims.cloud_table(found)
    moved = cloud_claims.moving_rope_clouds((0.005, 0.015), effort.seeds(3))
    yield "moving rope clouds, tracked", _rows(moved)
    yield "images at a slant", cloud_claims.tilted_table(cloud_claims.tilted_images(count, seed))


def _shapes(effort: Effort) -> Tables:
    yield "several shapes in one pass", _rows(shared_passes(effort.count(60), effort.seed))


def _markers(effort: Effort) -> Tables:
    top = marker_claims.tops(effort.count(40), effort.seed)
    yield "tables seen from above, by four markers", _rows([top])
    placed = [marker_claims.touched(effort.count(20), effort.seed, depth) for depth in (True, False)]
    yield "cameras placed by touching markers, 0.5 mm of noise along each axis", _rows(placed)
    cameras = marker_claims.fitted(effort.count(10), effort.seed)
    yield "cameras calibrated with a board", _rows([cameras])
    yield "markers and calibration, asked and seen", marker_claims.marker_rows(top, placed[0], cameras)


def _cable(effort: Effort) -> Tables:
    cameras = ("d455", "rl", [84, 84])
    title = "simulated cable, random actions, visible surface"
    yield title, _rows(claims.cable_episodes(camera, effort.renderer, effort.seeds(20)) for camera in cameras)


def _envs(effort: Effort) -> Tables:
    """Simulated environments: points, physics, goals."""
    every, seeds = env_claims.settings(effort.renderer), effort.seeds(150)
    ticks = _counted("episode", len(every) * len(seeds), effort.told)
    found = env_claims.all_episodes(every, seeds, effort.jobs, tick=ticks)
    rows = [env_claims.claim_row(setting, some) for setting, some in found.items()]
    yield "simulated environments, random actions, points against truth", rows
    of: dict[Env, list[env_claims.Episode]] = {
        env: [each for setting, some in found.items() if setting.env == env for each in some] for env in ENVS
    }
    physics = [env_claims.physics_row(env, some) for env, some in of.items()]
    yield "simulated environments, physics over these episodes", physics
    drawn: list[tuple[Env, str]] = [(env, how) for env in ENVS for how in env_goals.DIFFICULTIES]
    seeds = effort.seeds(50)
    ticks = _counted("goal", len(drawn) * len(seeds), effort.told)
    goals = [env_goals.goals(env, difficulty, seeds, ticks) for env, difficulty in drawn]
    yield "simulated environments, goals, and where their own actions lead", _rows(goals)
    asked = env_claims.asked_rows(rows, physics) + env_goals.asked_rows(goals)
    yield "simulated environments, asked and seen", asked


def _counted(what: str, total: int, told: Callable[[str], object]) -> Callable[[int], None]:
    """What is to be called with how many more are done."""
    done = 0

    def tick(more: int) -> None:
        nonlocal done
        done += more
        told(f"{what} {done} of {total}")

    return tick


def _camera(effort: Effort) -> Tables:
    yield (
        "depth registered to colour, ours and rs.align",
        registration.registration_table(effort.count(10), effort.seed),
    )
    yield "the time that takes at 640 x 480", registration.time_table()


def _deploy(effort: Effort) -> Tables:
    seconds = deploy_claims.SECONDS * effort.share
    for title, faults in (("clean", None), ("faulty", deploy_claims.FAULTS)):
        report, seen = deploy_claims.run(seconds, faults, seed=effort.seed, renderer=effort.renderer, told=effort.told)
        asked = deploy_claims.clean_table if faults is None else deploy_claims.faulty_table
        yield f"deployment, {title}: asked and seen", asked(report, seen)
        yield f"deployment, {title}: milliseconds by section", deploy_claims.section_table(report)


def _robustness(effort: Effort) -> Tables:
    """Signals and kills, random inputs, damaged and hostile files."""
    stopped = list(stops.stops(effort.count(3), effort.seed, effort.told))
    killed = list(stops.kills(effort.count(100), effort.seed, effort.told))
    yield "deployments that were ended: longest time until the robot stood still", stops.stop_table(stopped)
    asked = stops.asked_table(stopped, killed, list(stops.locked(effort.count(5))))
    yield "stopping the robot: asked and seen", asked
    for backend in ("numpy", "numba"):
        effort.told(f"robustness: random inputs, {backend}")
        yield (
            f"random and degenerate inputs, {backend}",
            inputs.inputs_table(effort.count(10_000), effort.seed, backend),
        )
    with TemporaryDirectory() as folder:
        damaged, studies = Path(folder, "damaged"), Path(folder, "studies")
        damaged.mkdir()
        studies.mkdir()
        effort.told("robustness: damaged files")
        counts = (effort.count(2000), effort.count(3000), effort.count(500))
        yield "damaged and hostile files", files.damaged_files(damaged, *counts, effort.seed)
        effort.told("robustness: bundles")
        mutated, kills = effort.count(1000), effort.count(30)
        yield "damaged and hostile bundles", bundles.bundle_claims(mutated, 1, kills, effort.seed)
        effort.told("robustness: killed studies")
        yield "ablations that were killed and resumed", killed_studies.killed_studies(studies, kills, effort.seed)


GROUPS: Final[dict[str, Callable[[Effort], Tables]]] = {
    "ropes": _ropes,
    "tangles": _tangles,
    "hands": _hands,
    "noise": _noise,
    "outlines": _outlines,
    "sheets": _sheets,
    "clouds": _clouds,
    "shapes": _shapes,
    "markers": _markers,
    "cable": _cable,
    "envs": _envs,
    "camera": _camera,
    "deploy": _deploy,
    "robustness": _robustness,
}


def _rows(results: Iterable[Any]) -> Rows:
    return [{name: _plain(value) for name, value in result._asdict().items()} for result in results]


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value
