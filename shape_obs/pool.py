"""Several cameras at once: a detector and a worker thread for each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from shape_obs.anchors import Anchors
from shape_obs.camera import CameraModel, Intrinsics
from shape_obs.detector import ShapeDetector
from shape_obs.shape import Detection

Images = (
    npt.NDArray[np.uint8]
    | tuple[npt.NDArray[np.uint8] | None, npt.NDArray[Any] | None]
    | tuple[npt.NDArray[np.uint8] | None, npt.NDArray[Any] | None, CameraModel | Intrinsics | None]
)


class DetectorPoolError(RuntimeError):
    """Some cameras failed; what the others saw is not lost.

    Attributes:
        errors: By the camera's place in the pool, what its detector raised.
        detections: One a camera, None for those that failed.
    """

    def __init__(self, errors: Mapping[int, BaseException], detections: Sequence[Detection | None]) -> None:
        told = "; ".join(f"camera {i}: {type(error).__name__}: {error}" for i, error in errors.items())
        super().__init__(told)
        self.errors, self.detections = dict(errors), list(detections)


class DetectorPool:
    """Runs one detector a camera, side by side in threads.

    OpenCV, NumPy's long loops and the Numba kernels let other threads run meanwhile; the Python between them does not.
    So a pool gains on large images and slow rules, and costs a little where a frame takes less than a millisecond.

    Args:
        detectors: One a camera, in the order of the frames. A detector keeps the track of what its camera sees, so no
            two cameras share one.

    Example:
        >>> with DetectorPool([ShapeDetector(segmentation=rule) for rule in (left_rule, right_rule)]) as pool:
        ...     left, right = pool.detect([(rgb, depth, intrinsics), (other_rgb, other_depth, other_intrinsics)])
    """

    def __init__(self, detectors: Iterable[ShapeDetector]) -> None:
        self.detectors = tuple(detectors)
        if not self.detectors:
            raise ValueError("a pool needs at least one detector, got none.")
        if len({id(detector) for detector in self.detectors}) < len(self.detectors):
            raise ValueError("a detector is given twice: each camera needs one of its own, which keeps its track.")
        self._threads = ThreadPoolExecutor(len(self.detectors), thread_name_prefix="shape_obs")

    def detect(
        self,
        frames: Sequence[Images],
        *,
        stamps: float | Sequence[float | None] | None = None,
        anchors: Anchors | Sequence[Anchors] = None,
    ) -> list[Detection]:
        """Find the shapes in a frame of each camera.

        Args:
            frames: One a camera: ``(rgb, depth, camera)``, ``(rgb, depth)`` or ``rgb``, as ``ShapeDetector.detect``
                takes them.
            stamps: Seconds: one for all cameras, or one each.
            anchors: Name -> place: one mapping for all cameras, or one each.

        Returns:
            The detections, in the order of the cameras.

        Raises:
            ValueError: Not as many frames, stamps or anchors as cameras.
            DetectorPoolError: A camera's detector raised an error; all cameras were processed before.
        """
        frames = self._one_each(frames, "frames")
        stamp = self._one_each([stamps] * len(frames) if stamps is None or _is_number(stamps) else stamps, "stamps")
        shared = anchors is None or isinstance(anchors, Mapping)
        places = self._one_each([anchors] * len(frames) if shared else anchors, "anchors")
        futures: list[Future[Detection]] = [
            self._threads.submit(detector.detect, *_images(frame), stamp=when, anchors=where)
            for detector, frame, when, where in zip(self.detectors, frames, stamp, places, strict=True)
        ]
        errors = {i: error for i, future in enumerate(futures) if (error := future.exception()) is not None}
        if errors:
            found = [None if i in errors else future.result() for i, future in enumerate(futures)]
            raise DetectorPoolError(errors, found) from next(iter(errors.values()))
        return [future.result() for future in futures]

    def reset(self) -> None:
        """Forget all tracks."""
        for detector in self.detectors:
            detector.reset()

    def close(self) -> None:
        """End the threads. A closed pool detects nothing more; its detectors go on."""
        self._threads.shutdown()

    def __len__(self) -> int:
        """How many cameras there are."""
        return len(self.detectors)

    def __enter__(self) -> DetectorPool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _one_each(self, values: Any, name: str) -> list[Any]:
        given = list(values)
        if len(given) != len(self.detectors):
            raise ValueError(f"{name}: expected one for each of the {len(self.detectors)} cameras, got {len(given)}.")
        return given


def _is_number(value: Any) -> bool:
    return np.ndim(value) == 0


def _images(frame: Images) -> tuple[Any, ...]:
    """The positional arguments of ``ShapeDetector.detect``."""
    return tuple(frame) if isinstance(frame, (tuple, list)) else (frame,)
