"""Run a controller on a robot at a fixed rate, safely."""

from __future__ import annotations

from shape_obs.deploy.controller import Controller, Script, Still, Sway
from shape_obs.deploy.loop import Step, deploy
from shape_obs.deploy.run_log import Report, RunLog
from shape_obs.deploy.run_recorder import RunRecorder
from shape_obs.deploy.safety import DryRobot, Gate, Limits
from shape_obs.deploy.supervision import Interrupted, supervised

__all__ = [
    "Controller",
    "DryRobot",
    "Gate",
    "Interrupted",
    "Limits",
    "Report",
    "RunLog",
    "RunRecorder",
    "Script",
    "Step",
    "Still",
    "Sway",
    "deploy",
    "supervised",
]
