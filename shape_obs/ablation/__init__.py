"""Ablation studies: repeat a training with different observations. Needs the extras ``sim`` and ``sb3``."""

from shape_obs.ablation.study import Arm, Disturbance, Evaluation, Study, load_study

__all__ = ["Arm", "Disturbance", "Evaluation", "Study", "load_study"]
