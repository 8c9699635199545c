"""Print the versions that matter, on one line."""

import platform
from importlib.metadata import version

PACKAGES = [
    "gymnasium",
    "numpy",
    "scipy",
    "scikit-learn",
    "opencv-python-headless",
    "mujoco",
    "onnx",
    "onnxruntime",
    "stable-baselines3",
    "torch",
]
print("python", platform.python_version(), *[f"{name} {version(name)}" for name in PACKAGES], flush=True)
