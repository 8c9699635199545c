"""Every measurement of the accuracy that the project claims, group by group, as tables.

A group imports its module when it runs, so that the command can list the groups quickly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import product
from pathlib import Path
from typing import Final, Literal, NamedTuple, get_args

from tests.benchmarks import ENVS
from tests.benchmarks.tables import Row

Tables = Iterator[tuple[str, Iterable[Row]]]
Group = Literal[
    "ropes", "tangles", "several", "hands", "motion", "belief", "noise", "outlines", "sheets", "clouds", "markers",
    "clicks", "cable", "envs", "camera", "deploy", "robustness", "time",
]  # fmt: skip


class Effort(NamedTuple):
    """How much to measure.

    Args:
        share: Share of the full counts; 1 is the full run.
        seed: Seed of everything that is drawn at random.
        renderer: The simulator's renderer.
        garments: A file of annotated garment outlines; None leaves them out.
        jobs: Processes for long measurements.
        report: Called with the progress of a long group.
        figures: Folder for the pictures of groups that have some; None draws none.
    """

    share: float
    seed: int
    renderer: str
    garments: Path | None
    jobs: int = 1
    report: Callable[[str], object] = lambda text: None
    figures: Path | None = None

    def count(self, full: int) -> int:
        """Return the share of a full count, at least one."""
        return max(round(full * self.share), 1)

    def seeds(self, full: int) -> range:
        """Return the share of a full number of seeds."""
        return range(self.seed, self.seed + self.count(full))


def _ropes(effort: Effort) -> Tables:
    from tests.benchmarks import rope_claims as ropes

    yield "drawn ropes, cold", ropes.rope_table(ropes.drawn_ropes(effort.count(40), effort.seed))
    yield "ropes bent to a few widths", ropes.bent_ropes(effort.count(4), effort.seed)
    yield "moving ropes, tracked", ropes.moving_ropes((10, 40), effort.seeds(6))
    yield "ropes at rest in masks that flicker", ropes.flickering_ropes(effort.count(4), effort.seed)


def _tangles(effort: Effort) -> Tables:
    from tests.benchmarks.tangle_claims import tangled_ropes

    title = "ropes that cross themselves, are cut, or touch themselves, cold"
    yield title, tangled_ropes(effort.count(100), effort.seed)


def _several(effort: Effort) -> Tables:
    from tests.benchmarks import rope_identity_claims as identity
    from tests.benchmarks import several_rope_claims as several
    from tests.benchmarks.several_rope_speed import warm_costs

    cold = list(several.cold_cells(effort.count(200), effort.seed))
    yield "scenes of several ropes of one colour, cold", cold
    tracked = identity.track_table(identity.rope_tracks(effort.seeds(60)))
    yield "three ropes that move, tracked over 180 frames", tracked
    above = several.levels(effort.count(200), effort.seed)
    yield "which strand is above, ropes of 8 mm or more at 0.6 m", above
    warm = warm_costs(effort.count(900), effort.seed)
    yield "the time of a frame, warm", warm
    yield "several ropes: asked and seen", several.targets(cold, tracked, above, warm)


def _hands(effort: Effort) -> Tables:
    from tests.benchmarks.rope_claims import ropes_under_hands

    yield "moving ropes under a hand", ropes_under_hands(effort.seeds(3))
    middle = ropes_under_hands(effort.seeds(3), places=("middle",))
    yield "moving ropes under a hand, in the middle", middle


def _motion(effort: Effort) -> Tables:
    from tests.benchmarks import contour_claims as contours
    from tests.benchmarks import motion_claims as motions
    from tests.benchmarks import surface_claims as surfaces

    hidden = motions.hidden_rope_tracks(effort.seeds(5))
    yield "ropes under what grows over them", motions.motion_table(hidden, ("cover", "depth"))
    swung = motions.swinging_rope_tracks(effort.seeds(50), noises=(False, True))
    yield "ropes swung in space", motions.motion_table(swung, ("hertz", "wall", "noise"))
    few, speeds = effort.seeds(50), (0.5, 1, 2, 4, 8, 16)
    flat = (
        ("outlines", contours.outlines_under_hands, contours.outlines_in_space),
        ("cloths", surfaces.cloths_under_hands, surfaces.cloths_in_space),
    )
    for what, under_hands, in_space in flat:
        for title, depth in (("the mask alone", False), ("with depth", True)):
            yield f"{what} over which a hand comes, stays and goes, {title}", under_hands(few, speeds, with_depth=depth)
        for title, noise in (("exact depth", False), ("the noise of a D455", True)):
            yield f"{what} in space, {title}", in_space(few, (8, 16, 40), noise=noise)


def _belief(effort: Effort) -> Tables:
    from tests.benchmarks import belief_claims

    rows = list(belief_claims.beliefs(effort.seeds(8), effort.renderer))
    yield "how far points are off, and what sigma says", belief_claims.reliability(rows)
    yield "belief: asked and seen", belief_claims.targets(rows)
    if effort.figures is not None:
        belief_claims.draw(rows, effort.figures)


def _noise(effort: Effort) -> Tables:
    from tests.benchmarks.rope_claims import ropes_in_noise

    yield "drawn ropes in noise, cold", ropes_in_noise(effort.count(12), effort.seed)


def _outlines(effort: Effort) -> Tables:
    from tests.benchmarks import contour_claims as contours
    from tests.benchmarks.scenes.blobs import garments

    blobs = list(contours.drawn_blobs(effort.count(8), effort.seed))
    yield "drawn outlines, cold", contours.outline_table(contours.outlines(blobs))
    if effort.garments is not None:
        yield "garments, cold", contours.outline_table(contours.outlines(garments(effort.garments)))
    yield "turning outlines, tracked", contours.turning_blobs(seeds=effort.seeds(2))
    some = blobs[:: len(blobs) // 4 or 1]
    yield "outlines at rest in masks that flicker", contours.flickering_blobs(some)


def _sheets(effort: Effort) -> Tables:
    from tests.benchmarks import surface_claims as surfaces

    seeds = effort.seeds(6)
    yield "drawn sheets, cold", surfaces.sheet_table(surfaces.drawn_sheets(effort.count(48), effort.seed))
    yield "sheets that turn once around, in steps of a degree", surfaces.turning_sheets(seeds)
    yield "sheets that wander, turn and bend, tracked", surfaces.moving_sheets((12,), seeds)
    yield "sheets at rest in masks that flicker", surfaces.noisy_sheets(seeds)


def _clouds(effort: Effort) -> Tables:
    from tests.benchmarks import cloud_claims as clouds

    count, seed = effort.count(30), effort.seed
    found = [*clouds.rope_clouds(count, seed), *clouds.ring_clouds(count, seed), *clouds.sheet_clouds(count, seed)]
    yield "clouds, cold", clouds.cloud_table(found)
    yield "moving rope clouds, tracked", clouds.moving_rope_clouds((0.005, 0.015), effort.seeds(3))
    yield "images at a slant", clouds.tilted_table(clouds.tilted_images(count, seed))


def _markers(effort: Effort) -> Tables:
    from tests.benchmarks import marker_claims as markers

    top = markers.tops(effort.count(40), effort.seed)
    yield "tables seen from above, by four markers", [top]
    placed = [markers.touched(effort.count(20), effort.seed, depth) for depth in (True, False)]
    yield "cameras placed by touching markers, 0.5 mm of noise along each axis", placed
    cameras = markers.fitted(effort.count(10), effort.seed)
    yield "cameras calibrated with a board", [cameras]
    yield "markers and calibration, asked and seen", markers.targets(top, placed[0], cameras)


def _clicks(effort: Effort) -> Tables:
    from tests.benchmarks import click_claims as clicks
    from tests.benchmarks.scenes.object_photos import object_photos

    table = clicks.click_table(clicks.by_clicks(object_photos(effort.count(280), effort.seed)))
    yield "clicks on drawn photos, and the same clicks for others", table
    costs = clicks.frame_costs(effort.count(300), effort.seed)
    yield "a frame at 640 x 480 by clicked colours", costs
    yield "clicks: asked and seen", clicks.targets(table, costs)


def _cable(effort: Effort) -> Tables:
    from tests.benchmarks.rope_claims import cable_episodes

    cameras = ("d455", "rl", [84, 84])
    title = "simulated cable, random actions, visible surface"
    yield title, (cable_episodes(camera, effort.renderer, effort.seeds(20)) for camera in cameras)


def _envs(effort: Effort) -> Tables:
    from tests.benchmarks import env_claims as envs
    from tests.benchmarks import env_physics

    settings, seeds = envs.settings(effort.renderer), effort.seeds(150)
    found = envs.all_episodes(settings, seeds, effort.jobs, report=effort.report)
    rows, physics = envs.claim_table(found), envs.physics_table(found)
    yield "simulated environments, random actions, points against truth", rows
    yield "simulated environments, physics over these episodes", physics
    goals = []
    for env, difficulty in product(ENVS, env_physics.DIFFICULTIES):
        effort.report(f"goals of {env}, {difficulty}")
        goals.append(env_physics.goals(env, difficulty, effort.seeds(50)))
    yield "simulated environments, goals, and where their own actions lead", goals
    yield "simulated environments, asked and seen", envs.targets(rows, physics) + env_physics.targets(goals)


def _camera(effort: Effort) -> Tables:
    from tests.benchmarks import registration_claims as registration

    table = registration.registration_table(effort.count(10), effort.seed)
    yield "depth registered to colour, ours and rs.align", table
    yield "the time that takes at 640 x 480", registration.time_table()


def _deploy(effort: Effort) -> Tables:
    from tests.benchmarks import deploy_claims as deployment

    seconds = deployment.SECONDS * effort.share
    for title, faults in (("clean", None), ("faulty", deployment.FAULTS)):
        report, seen = deployment.run(
            seconds, faults, seed=effort.seed, renderer=effort.renderer, progress=effort.report
        )
        targets = deployment.clean_targets if faults is None else deployment.faulty_targets
        yield f"deployment, {title}: asked and seen", targets(report, seen)
        yield f"deployment, {title}: milliseconds by section", deployment.section_table(report)


def _robustness(effort: Effort) -> Tables:
    from tests.benchmarks import stop_claims

    stopped = stop_claims.stops(effort.count(3), effort.seed, effort.report)
    killed = stop_claims.kills(effort.count(100), effort.seed, effort.report)
    yield "deployments that were ended: longest time until the robot stood still", stop_claims.stop_table(stopped)
    locked = stop_claims.locked(effort.count(5), effort.report)
    yield "stopping the robot: asked and seen", stop_claims.targets(stopped, killed, locked)


def _time(effort: Effort) -> Tables:
    from tests.benchmarks import worst_case_claims as worst

    some = tuple(worst.PATTERNS)[:: max(round(1 / effort.share), 1)]
    cold = [row for size in worst.SIZES for row in worst.worst_cases(size, effort.seed, patterns=some)]
    tracked = list(worst.hiccups(effort.seed, patterns=some[::4]))
    title = "processor time of a frame that shows no object, without a track"
    yield title, worst.slowest(cold, ("size", "shape", "given"), ("ms", "passes"))
    title = "processor time of such a frame in a tracked sequence, and after it"
    yield title, worst.slowest(tracked, ("shape", "given"), ("bad_ms", "after_ms"))
    yield "frames that show no object: asked and seen", worst.targets(cold, tracked)


_FUNCTIONS: Final = (
    _ropes, _tangles, _several, _hands, _motion, _belief, _noise, _outlines, _sheets, _clouds, _markers, _clicks,
    _cable, _envs, _camera, _deploy, _robustness, _time,
)  # fmt: skip
GROUPS: Final[dict[Group, Callable[[Effort], Tables]]] = dict(zip(get_args(Group), _FUNCTIONS, strict=True))
