"""All episodes of all settings, here or in several processes; what is done is kept, so that a run can go on.

The files of a study: tables, for people and for programs.
"""

from __future__ import annotations
import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from shape_obs import __version__
from shape_obs.bench.servo.episode import STEPS, Episode, episodes
from shape_obs.bench.servo.settings import Setting
from shape_obs.bench.servo.summary import episode_rows, paired_rows, summary_rows
from shape_obs.utils.documents import read_json
from shape_obs.utils.files import make_folder, write_text

Found = Mapping[Setting, Sequence[Episode]]
_CHUNK: Final = 5  # episodes for which a world is made
_PARTS: Final = "parts"
Row = Mapping[str, Any]
_IF_ANY: Final = ("failed", "invalid")


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
        settings: What is compared.
        seeds: One for each goal; equal for all settings.
        steps: Of an episode.
        jobs: Processes.
        folder: Where episodes are kept as they are done; None keeps them nowhere.
        resume: Take from there what was kept before, but what broke off.
        tick: Called with each episode, also with those that were kept.

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
    for setting, episode in _worked_off(tasks, jobs):
        kept[setting][episode.seed] = episode
        if folder is not None:
            _write(folder, setting, steps, kept[setting])
        tick(setting, episode)
    return {setting: [done[seed] for seed in seeds] for setting, done in kept.items()}


def _worked_off(tasks: Sequence[tuple[Setting, list[int], int]], jobs: int) -> Iterator[tuple[Setting, Episode]]:
    if jobs == 1:
        for setting, seeds, steps in tasks:
            for episode in episodes(setting, seeds, steps):
                yield setting, episode
    else:
        from joblib import Parallel, delayed

        workers: Any = Parallel(n_jobs=jobs, return_as="generator_unordered")
        for setting, found in workers(delayed(_work)(*task) for task in tasks):
            for episode in found:
                yield setting, episode


def _work(setting: Setting, seeds: Sequence[int], steps: int) -> tuple[Setting, list[Episode]]:
    return setting, list(episodes(setting, seeds, steps))


def _read(folder: Path, setting: Setting, steps: int) -> dict[int, Episode]:
    """The episodes of a setting that were kept, by their seeds; what broke off is to be tried again."""
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
                    "another folder, or leave out --resume to write them anew."
                )
        found = [Episode.from_dict(values) for values in kept]
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: not the episodes of a study ({error!r}): remove it to play them again.") from error
    return {episode.seed: episode for episode in found if not episode.failure}


def _write(folder: Path, setting: Setting, steps: int, done: Mapping[int, Episode]) -> None:
    document = {
        "made_with": _made_with(setting, steps),
        "episodes": [done[seed].to_dict() for seed in sorted(done)],
    }
    write_text(_path(folder, setting), json.dumps(document, separators=(",", ":")) + "\n")


def _made_with(setting: Setting, steps: int) -> dict[str, Any]:
    return {"shape_obs": __version__, "steps": steps, "renderer": setting.renderer, "pca": setting.pca}


def _path(folder: Path, setting: Setting) -> Path:
    return folder / _PARTS / f"{setting.name}.json"


def write_tables(found: Found, folder: Path) -> None:
    """Write ``episodes.csv``, ``summary.csv`` and ``table.md``, and ``paired.csv`` where there are pairs."""
    rows, pairs = summary_rows(found), paired_rows(found)
    write_text(folder / "episodes.csv", as_csv(episode_rows(found)))
    write_text(folder / "summary.csv", as_csv(rows))
    if pairs:
        write_text(folder / "paired.csv", as_csv(pairs))
    page = "# Shape servoing\n\n" + as_markdown(lean(rows))
    if pairs:
        page += "\n\n## The camera beside the true points\n\n" + as_markdown(lean(pairs))
    write_text(folder / "table.md", page + "\n")


def lean(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Rows without the columns that hold nothing: no disturbance, no failure, no detector."""
    if not rows:
        return []
    kept = [name for name in rows[0] if any(row[name] not in (None, "") for row in rows)]
    kept = [name for name in kept if name not in _IF_ANY or any(row[name] for row in rows)]
    return [{name: row[name] for name in kept} for row in rows]


def as_csv(rows: Sequence[Row]) -> str:
    """Rows of equal keys, the keys first; None is an empty cell."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def as_markdown(rows: Sequence[Row]) -> str:
    """Rows of equal keys as a table in Markdown, shares and millimetres to one decimal."""
    names = list(rows[0])
    numeric = [all(isinstance(row[name], (int, float, type(None))) for row in rows) for name in names]
    lines = [names, ["---:" if right else "---" for right in numeric]]
    lines += [[_cell(value) for value in row.values()] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 10 else f"{value:.0f}"
    return str(value)
