"""Ablations: the same training with other things to see; needs the extras ``sim`` and ``sb3``."""

from shape_obs.ablation.study import Arm
from shape_obs.ablation.study import Disturbance
from shape_obs.ablation.study import Evaluation, Study, load_study

__all__ = ["Arm", "Disturbance", "Evaluation", "Study", "load_study"]
