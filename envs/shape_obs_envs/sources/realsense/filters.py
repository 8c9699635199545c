"""DepthFilters: librealsense's post-processing of depth, by name."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any, Final

from shape_obs_envs.sources.realsense.driver import librealsense

_LOG: Final = logging.getLogger(__name__)
#: name -> its parameters: librealsense's option
_FILTERS: Final[dict[str, dict[str, str]]] = {
    "temporal": {"alpha": "filter_smooth_alpha", "delta": "filter_smooth_delta", "persistence": "holes_fill"},
    "spatial": {
        "magnitude": "filter_magnitude",
        "alpha": "filter_smooth_alpha",
        "delta": "filter_smooth_delta",
        "holes": "holes_fill",
    },
    "threshold": {"min_distance": "min_distance", "max_distance": "max_distance"},
    "hole_filling": {"mode": "holes_fill"},
}
_WARNINGS: Final = {
    "hole_filling": "invents depth where there was none, and points on it count as measured",
    "spatial": "takes tens of milliseconds for each frame and rounds edges",
}
Filter = str | tuple[str, Mapping[str, float]]


class DepthFilters:
    """Runs depth frames through filters, in the order given.

    Args:
        filters: Names, or pairs of a name and its parameters: ``("temporal", {"alpha": 0.4, "delta": 20})``.

    Raises:
        ValueError: An unknown name or parameter, a value out of its range, or ``"decimation"``.
    """

    def __init__(self, filters: Sequence[Filter]) -> None:
        self._blocks = [_block(*((one, {}) if isinstance(one, str) else one)) for one in filters]

    def __call__(self, frame: Any) -> Any:
        """A depth frame -> a depth frame of the same size."""
        for block in self._blocks:
            frame = block.process(frame)
        return frame


def check_names(filters: Sequence[Filter]) -> None:
    """Refuse what no filter is called, without librealsense.

    Raises:
        ValueError: As `DepthFilters` does, but for values.
    """
    if isinstance(filters, str):
        raise ValueError(f"filters: expected a sequence of names, got {filters!r}; write ({filters!r},).")
    for one in filters:
        name, parameters = (one, {}) if isinstance(one, str) else one
        if name == "decimation":
            raise ValueError(
                "filters: 'decimation' changes the size of the depth image; choose a smaller stream instead, "
                "width=424, height=240 for example."
            )
        if name not in _FILTERS:
            raise ValueError(f"filters: expected {', '.join(map(repr, _FILTERS))}, got {name!r}.")
        for key in parameters:
            if key not in _FILTERS[name]:
                raise ValueError(f"filters: {name!r} has the parameters {', '.join(_FILTERS[name])}, not {key!r}.")


def _block(name: str, parameters: Mapping[str, float]) -> Any:
    check_names(((name, parameters),))
    if name in _WARNINGS:
        _LOG.warning("The depth filter %r %s.", name, _WARNINGS[name])
    rs = librealsense()
    block = getattr(rs, f"{name}_filter")()
    for key, value in parameters.items():
        option = getattr(rs.option, _FILTERS[name][key])
        limits = block.get_option_range(option)
        if not limits.min <= value <= limits.max:
            raise ValueError(f"filters: {name}: {key} must be {limits.min:g} to {limits.max:g}, got {value}.")
        block.set_option(option, value)
    return block
