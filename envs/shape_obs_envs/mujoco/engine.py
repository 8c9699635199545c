"""The MuJoCo module, with an error that says how to get it."""

from __future__ import annotations

import importlib
from typing import Any

try:
    # Any: the module's names come from its C extensions, of which a type checker sees a part.
    mujoco: Any = importlib.import_module("mujoco")
except ModuleNotFoundError as error:
    if error.name != "mujoco":  # MuJoCo is there and one of its own imports is not: its message is the better one
        raise
    raise ImportError(
        "The simulated environments need MuJoCo, which is not installed. "
        'Install it with: pip install "shape-obs[sim]" (or: pip install "mujoco>=3.3").'
    ) from error

__all__ = ["mujoco"]
