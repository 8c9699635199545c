"""Ordered shape vectors of deformable objects from RGB-D: in simulation and on the robot alike.

Names are loaded on first use, so that ``import shape_obs`` stays light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from shape_obs.camera import CameraModel as CameraModel
    from shape_obs.camera import Intrinsics as Intrinsics
    from shape_obs.config.config_file import load_config as load_config
    from shape_obs.config.config_file import save_config as save_config
    from shape_obs.config.config_file import schema_hash as schema_hash
    from shape_obs.configurations.base import Configuration as Configuration
    from shape_obs.configurations.centerline import Centerline as Centerline
    from shape_obs.configurations.contour import Contour as Contour
    from shape_obs.configurations.surface import Surface as Surface
    from shape_obs.detector import ShapeDetector as ShapeDetector
    from shape_obs.drawing import log_rerun as log_rerun
    from shape_obs.extrinsics import Extrinsics as Extrinsics
    from shape_obs.features import Feature as Feature
    from shape_obs.frame import Frame as Frame
    from shape_obs.image.marker_roi import Markers as Markers
    from shape_obs.image.mask_function import MaskFunction as MaskFunction
    from shape_obs.image.roi import ROI as ROI
    from shape_obs.image.roi import Polygon as Polygon
    from shape_obs.image.roi import Rectangle as Rectangle
    from shape_obs.image.roi import Whole as Whole
    from shape_obs.image.segmentation import ColourRule as ColourRule
    from shape_obs.image.segmentation import DepthRange as DepthRange
    from shape_obs.image.segmentation import GrayRange as GrayRange
    from shape_obs.image.segmentation import HSVRange as HSVRange
    from shape_obs.image.segmentation import Segmentation as Segmentation
    from shape_obs.markers import MarkerLayout as MarkerLayout
    from shape_obs.markers import TopView as TopView
    from shape_obs.markers import find_markers as find_markers
    from shape_obs.policy import load_policy as load_policy
    from shape_obs.policy import save_policy as save_policy
    from shape_obs.policy import save_policy_onnx as save_policy_onnx
    from shape_obs.shape import Detection as Detection
    from shape_obs.shape import Shape as Shape
    from shape_obs.spec import Spec as Spec
    from shape_obs.spec import SpecError as SpecError
    from shape_obs.tracking.missing import ShapeLostError as ShapeLostError
    from shape_obs.wrappers import ShapeGoal as ShapeGoal
    from shape_obs.wrappers import ShapeObservation as ShapeObservation
    from shape_obs.wrappers import Target as Target
    from shape_obs.wrappers import record_goal as record_goal
    from shape_obs.wrappers import record_goals as record_goals

__version__ = "0.1.0"

_HOME = {
    "shape_obs.policy": ("load_policy", "save_policy", "save_policy_onnx"),
    "shape_obs.camera": ("CameraModel", "Intrinsics"),
    "shape_obs.config.config_file": ("load_config", "save_config", "schema_hash"),
    "shape_obs.configurations.base": ("Configuration",),
    "shape_obs.configurations.centerline": ("Centerline",),
    "shape_obs.configurations.contour": ("Contour",),
    "shape_obs.configurations.surface": ("Surface",),
    "shape_obs.detector": ("ShapeDetector",),
    "shape_obs.drawing": ("log_rerun",),
    "shape_obs.extrinsics": ("Extrinsics",),
    "shape_obs.features": ("Feature",),
    "shape_obs.frame": ("Frame",),
    "shape_obs.markers": ("MarkerLayout", "TopView", "find_markers"),
    "shape_obs.tracking.missing": ("ShapeLostError",),
    "shape_obs.image.marker_roi": ("Markers",),
    "shape_obs.image.mask_function": ("MaskFunction",),
    "shape_obs.image.roi": ("ROI", "Polygon", "Rectangle", "Whole"),
    "shape_obs.image.segmentation": ("ColourRule", "DepthRange", "GrayRange", "HSVRange", "Segmentation"),
    "shape_obs.shape": ("Detection", "Shape"),
    "shape_obs.spec": ("Spec", "SpecError"),
    "shape_obs.wrappers": ("ShapeGoal", "ShapeObservation", "Target", "record_goal", "record_goals"),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = sorted(_MODULE_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in ("save_bundle", "load_bundle"):  # ``from shape_obs import`` replaces the message of an AttributeError
        raise ImportError(f"shape_obs.{name} was removed: call shape_obs.{name.replace('bundle', 'policy')}.")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'shape_obs' has no attribute {name!r}; it has: {', '.join(__all__)}.")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
