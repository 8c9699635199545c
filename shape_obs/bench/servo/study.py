"""Play all episodes of all settings, here or in several processes, and keep them so that a run can continue."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from shape_obs import __version__
from shape_obs.bench.servo.episode import STEPS, Episode, Found, episodes
from shape_obs.bench.servo.settings import Setting
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import make_folder, write_text

_CHUNK: Final = 5  # episodes for which a world is made
_PARTS: Final = "parts"


def run(
    settings: Sequence[Setting],
    seeds: Sequence[int],
    *,
    steps: int = STEPS,
    jobs: int = 1,
    folder: Path | None = None,
    resume: bool = False,
    tick: Callable[[Setting, Episode], object] = lambda setting, episode: None,
) -> Found:
    """Play the same goals under every setting.

    Args:
        settings: The settings to compare.
        seeds: One seed for each goal, the same for all settings.
        steps: Steps of an episode.
        jobs: Number of processes.
        folder: Where finished episodes are kept; None keeps them nowhere.
        resume: Use the episodes in the folder, except those that broke off.
        tick: Called with each episode, kept ones included.

    Returns:
        The episodes of each setting, in the order of the seeds.

    Raises:
        ValueError: The folder holds episodes of another version or length, or a setting is not understood.
    """
    kept: dict[Setting, dict[int, Episode]] = {setting: {} for setting in settings}
    if folder is not None:
        make_folder(folder / _PARTS)
        if resume:
            kept = {setting: _read(folder, setting, steps) for setting in settings}
    tasks = []
    for setting, done in kept.items():
        for seed in seeds:
            if seed in done:
                tick(setting, done[seed])
        left = [seed for seed in seeds if seed not in done]
        tasks += [(setting, left[first : first + _CHUNK], steps) for first in range(0, len(left), _CHUNK)]
    for setting, episode in _played(tasks, jobs):
        kept[setting][episode.seed] = episode
        if folder is not None:
            done = [kept[setting][seed].to_dict() for seed in sorted(kept[setting])]
            document = {"made_with": _made_with(setting, steps), "episodes": done}
            write_text(_path(folder, setting), json.dumps(document, separators=(",", ":")) + "\n")
        tick(setting, episode)
    return {setting: [done[seed] for seed in seeds] for setting, done in kept.items()}


def _played(tasks: Sequence[tuple[Setting, list[int], int]], jobs: int) -> Iterator[tuple[Setting, Episode]]:
    if jobs == 1:
        for setting, seeds, steps in tasks:
            for episode in episodes(setting, seeds, steps):
                yield setting, episode
    else:
        from joblib import Parallel, delayed

        workers: Any = Parallel(n_jobs=jobs, return_as="generator_unordered")
        for setting, found in workers(delayed(_chunk)(*task) for task in tasks):
            for episode in found:
                yield setting, episode


def _chunk(setting: Setting, seeds: Sequence[int], steps: int) -> tuple[Setting, list[Episode]]:
    return setting, list(episodes(setting, seeds, steps))


def _read(folder: Path, setting: Setting, steps: int) -> dict[int, Episode]:
    """Return the kept episodes of a setting by seed, without those that broke off."""
    path = _path(folder, setting)
    if not path.exists():
        return {}
    document = read_json(path, "episodes")
    try:
        before, kept = dict(document["made_with"]), list(document["episodes"])
        for name, now in _made_with(setting, steps).items():
            if before.get(name) != now:
                raise ValueError(
                    f"{path} holds episodes with {name} = {before.get(name)}, this run has {now}: choose "
                    "another folder, or leave out --resume to play them again."
                )
        found = [Episode.from_dict(values) for values in kept]
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: not the episodes of a study ({error!r}): remove it to play them again.") from error
    return {episode.seed: episode for episode in found if not episode.failure}


def _made_with(setting: Setting, steps: int) -> Mapping[str, Any]:
    return {"shape_obs": __version__, "steps": steps, "renderer": setting.renderer, "pca": setting.pca}


def _path(folder: Path, setting: Setting) -> Path:
    return folder / _PARTS / f"{setting.name}.json"
