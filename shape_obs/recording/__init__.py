"""Record frames and robots from any source in a folder, and replay them through a detector into a table and a video."""

from __future__ import annotations

from shape_obs.recording.format import Moment as Moment
from shape_obs.recording.format import RobotInfo as RobotInfo
from shape_obs.recording.format import Transition as Transition
from shape_obs.recording.overlay import OverlayVideo as OverlayVideo
from shape_obs.recording.reader import Recording as Recording
from shape_obs.recording.record import Recorded as Recorded
from shape_obs.recording.record import record as record
from shape_obs.recording.replay import ShapeLog as ShapeLog
from shape_obs.recording.replay import replay as replay
from shape_obs.recording.table import ShapeTable as ShapeTable
from shape_obs.recording.writer import RecordingWriter as RecordingWriter
