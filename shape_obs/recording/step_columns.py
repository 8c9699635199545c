"""Turn the recorded steps of a robot into columns of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shape_obs.recording.transition import Transition

Column = npt.NDArray[Any]

#: Columns of vectors, whose width differs between robots; their names are in the metadata under ``robot``.
VECTORS: Final = ("action", "state")
#: Columns that tables of recordings without a robot do not have.
STEP_COLUMNS: Final = ("step", "action", "reward", "terminated", "truncated", "state")


def step_columns(
    episodes: Sequence[int],
    transitions: Sequence[Transition | None],
    states: Sequence[tuple[float, ...] | None],
) -> dict[str, Column]:
    """Return the columns ``step``, ``action``, ``reward``, ``terminated``, ``truncated`` and ``state``.

    A recording keeps with each frame the step that led to it. A row of a table holds the step that followed its frame,
    as datasets for learning do: the action that was chosen for the frame, and what came of it. The last frame of an
    episode, and a frame whose successor is missing, have none.

    Args:
        episodes: Number of the episode of each of the F frames, in their order.
        transitions: The step that led to each frame.
        states: The state in each frame.

    Returns:
        ``step`` ``(F,)`` int64, -1 if unknown; ``action`` ``(F, A)`` and ``state`` ``(F, S)``, NaN where there is none;
        ``reward`` ``(F,)``, NaN if no step followed; ``terminated`` and ``truncated`` ``(F,)`` bool. A and S are 0 if
        no frame has an action or a state.

    Raises:
        ValueError: The number of values of actions or states changes.
    """
    count = len(episodes)
    columns: dict[str, Column] = {
        "step": np.array([-1 if each is None else each.step for each in transitions], np.int64),
        "action": np.full((count, _width("action", [each and each.action for each in transitions])), np.nan),
        "reward": np.full(count, np.nan),
        "terminated": np.zeros(count, np.bool_),
        "truncated": np.zeros(count, np.bool_),
        "state": np.full((count, _width("state", states)), np.nan),
    }
    for i, state in enumerate(states):
        if state is not None:
            columns["state"][i] = state
    for i in range(count - 1):
        now, then = transitions[i], transitions[i + 1]
        if now is None or then is None or episodes[i] != episodes[i + 1]:
            continue
        if then.step != now.step + 1:
            continue  # a frame between the two was dropped
        columns["reward"][i] = np.nan if then.reward is None else then.reward
        columns["terminated"][i], columns["truncated"][i] = then.terminated, then.truncated
        if then.action is not None:
            columns["action"][i] = then.action
    return columns


def absent(columns: Mapping[str, Column]) -> dict[str, npt.NDArray[np.bool_]]:
    """Return for each column of ``step_columns`` in a table which rows ``(F,)`` hold nothing."""
    if "step" not in columns:
        return {}
    unknown = np.isnan(columns["reward"])
    empty = {name: np.asarray(np.isnan(columns[name]).all(axis=1)) for name in VECTORS}
    return {"step": columns["step"] < 0, **dict.fromkeys(("reward", "terminated", "truncated"), unknown), **empty}


def _width(name: str, vectors: Sequence[tuple[float, ...] | None]) -> int:
    widths = {len(vector) for vector in vectors if vector is not None}
    if len(widths) > 1:
        raise ValueError(f"{name}: expected equally many values in every frame, got {sorted(widths)}.")
    return max(widths, default=0)
