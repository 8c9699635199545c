"""Calibration: the camera's projection from a board, and its place in the base frame from touched markers."""

from __future__ import annotations

from shape_obs.calibration.board import Board as Board
from shape_obs.calibration.board import BoardView as BoardView
from shape_obs.calibration.board import BoardViews as BoardViews
from shape_obs.calibration.hand_eye import BaseFit as BaseFit
from shape_obs.calibration.hand_eye import fit_base as fit_base
from shape_obs.calibration.hand_eye import marker_points as marker_points
from shape_obs.calibration.intrinsics import IntrinsicsFit as IntrinsicsFit
from shape_obs.calibration.intrinsics import fit_intrinsics as fit_intrinsics
from shape_obs.calibration.touch_points import Touch as Touch
from shape_obs.calibration.touch_points import read_touches as read_touches
from shape_obs.calibration.touch_points import write_touches as write_touches
