"""A function of the user's as the pixel rule: a neural network, another library, or any code that returns a mask."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from shape_obs.frame import Frame
from shape_obs.image.mask_check import checked_mask
from shape_obs.image.roi import Window
from shape_obs.image.segmentation import Segmentation
from shape_obs.spec import SpecError
from shape_obs.utils.documents import is_of_script, load_named

_PATH: Final = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")


@dataclass(frozen=True)
class MaskFunction(Segmentation, kind="callable"):
    """Let a function decide which pixels belong to the object.

    The function is called as ``function(rgb, depth)``, once for each frame and with the whole image, whatever the
    region of interest and the number of shapes. ``rgb`` is ``(H, W, 3)`` uint8 or None, ``depth`` is ``(H, W)`` uint16
    millimetres or float32 metres or None; it must not change them. It returns the mask, ``(H, W)`` bool, or whole
    numbers 0 and 1 or 0 and 255.

    Args:
        function: The function itself, or its import path ``"module:function"``. A function at the top of a module is
            stored as its path, which files and ``env.spec`` record. Any other callable (a lambda, a nested function, a
            method, an object) works in a detector, but cannot be saved.

    Example:
        >>> def dark(rgb, depth):
        ...     return rgb.max(axis=2) < 60
        >>> detector = ShapeDetector(["centerline"], segmentation=dark)  # doctest: +SKIP
        >>> segmentation = MaskFunction("my_lab.masks:dark", close=5)  # doctest: +SKIP
        >>> detector = ShapeDetector(["centerline"], segmentation=segmentation)  # doctest: +SKIP
    """

    function: Any
    whole_image: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        function = self.function
        if isinstance(function, str):
            if not _PATH.fullmatch(function):
                raise SpecError(f"callable: expected module:function, such as my_lab.masks:rope, got {function!r}.")
        elif isinstance(function, type) or not callable(function):
            raise SpecError(
                "callable: expected a function (rgb, depth) -> mask or its import path 'module:function', got "
                f"{function!r:.100}."
            )
        else:
            object.__setattr__(self, "function", import_path(function) or function)

    def __hash__(self) -> int:
        # An object that is called need not be hashable.
        key = self.function if isinstance(self.function, str) else id(self.function)
        return hash((key, self.open, self.close, self.min_area, self.min_share))

    def to_dict(self) -> dict[str, Any]:
        """Return the spec as JSON values.

        Raises:
            SpecError: The function has no import path.
        """
        if not isinstance(self.function, str):
            raise SpecError(
                f"segmentation: {self.function!r:.100} cannot be saved or recorded, since it has no import path. "
                "Define a function with def at the top of a module, and give it, or its path 'module:function'."
            )
        return super().to_dict()

    @property
    def label(self) -> str:
        """What error messages call the rule."""
        if isinstance(self.function, str):
            return f"segmentation {self.function}"
        return f"segmentation {getattr(self.function, '__qualname__', type(self.function).__name__)}"

    @property
    def code_path(self) -> str:
        """The import path of the function; empty if it has none."""
        return self.function if isinstance(self.function, str) else ""

    def prepare(self) -> None:
        """Import the function.

        Raises:
            ImportError: Its module cannot be imported.
            ValueError: There is no such function in it.
        """
        self._loaded()

    def threshold(self, frame: Frame, window: Window) -> npt.NDArray[np.uint8]:
        """Call the function with the whole image; return the part of its mask in the window."""
        assert frame.size is not None
        return checked_mask(self._loaded()(frame.rgb, frame.depth), frame.size, self.label)[window.slices]

    def _loaded(self) -> Callable[[Any, Any], Any]:
        path = self.function
        if not isinstance(path, str):
            return path
        try:
            function = load_named(path, "segmentation")
        except (ImportError, ValueError) as error:
            if not is_of_script(path):
                raise
            raise ValueError(
                f"segmentation: {path} was defined in the script or notebook that recorded it, and is not known here. "
                "Move the function to a module, and record it again."
            ) from error
        if isinstance(function, type) or not callable(function):
            raise ValueError(
                f"segmentation: expected a function (rgb, depth) -> mask as {path}, got {function!r:.100}; of a class "
                "name an object."
            )
        return function


def import_path(function: Any) -> str | None:
    """Return the path ``"module:function"`` that leads to a function; None if there is none, as for a lambda."""
    module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", None)
    if not isinstance(module, str) or not isinstance(name, str) or not _PATH.fullmatch(f"{module}:{name}"):
        return None
    return f"{module}:{name}" if getattr(sys.modules.get(module), name, None) is function else None
