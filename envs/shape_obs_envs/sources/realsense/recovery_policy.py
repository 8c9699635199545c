"""Recovery of a camera that delivers no frames: wait, restart the pipeline, reset the camera, look it up again."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Final

from shape_obs.source import CameraLost, CameraNotFound, SourceError
from shape_obs_envs.sources.realsense.devices import Device
from shape_obs_envs.sources.realsense.session import Session

_LOG: Final = logging.getLogger(__name__)
_STEPS: Final = ("wait", "restart the pipeline", "reset the camera", "look for the camera again")
#: Seconds until a camera has disappeared after a reset.
_RESET: Final = 2.0


class RecoveryPolicy:
    """Take one recovery step per call until frames come again or the time limit is reached.

    Args:
        device: The camera.
        open_session: Starts a new session, with a new context and config.
        recover_timeout: Seconds without a frame after which the camera counts as lost.
        stopping: Set when the camera is no longer needed.

    Attributes:
        state: The present step, for messages; empty while frames come.
    """

    def __init__(
        self,
        device: Device,
        open_session: Callable[[], Session],
        recover_timeout: float,
        stopping: threading.Event,
    ) -> None:
        self._device, self._open, self._stopping = device, open_session, stopping
        self._recover_timeout = recover_timeout
        self._step, self.state = 0, ""

    def reset(self, who: object) -> None:
        """Return to the first step, because a frame came."""
        if self._step:
            _LOG.warning("%s delivers frames again.", who)
        self._step, self.state = 0, ""

    def next_step(self, session: Session | None, silent: float) -> Session | None:
        """Take the next step.

        Args:
            session: The session that delivers no frames, or None.
            silent: Seconds since the last frame.

        Returns:
            The session to continue with; None while there is no camera.

        Raises:
            CameraLost: The time limit is reached.
        """
        who = str(session.identity) if session is not None else self._device.name
        if silent > self._recover_timeout:
            if session is not None:
                session.stop()
            raise CameraLost(
                f"{who} has delivered no frame for {silent:.1f} s, and neither a restart nor a reset helped"
                f"{self.state and f' ({self.state})'}: check the cable and its port, then connect again."
            )
        step = _STEPS[min(self._step, len(_STEPS) - 1)]
        self._step += 1
        self.state = f"step {min(self._step, len(_STEPS))} of {len(_STEPS)}: {step}"
        _LOG.warning("%s has delivered no frame for %.1f s; %s.", who, silent, self.state)
        if self._step == 1:
            return session
        if session is not None:
            session.stop()
        if step == "reset the camera":
            self._reset_camera()
        return self._reopen()

    def _reset_camera(self) -> None:
        try:
            self._device.find().hardware_reset()
        except (RuntimeError, SourceError) as error:
            _LOG.warning("%s could not be reset: %s", self._device.name, error)
        else:
            self._stopping.wait(_RESET)

    def _reopen(self) -> Session | None:
        if self._stopping.is_set():
            return None
        started = time.monotonic()
        try:
            session = self._open()
        except CameraNotFound as error:
            self.state = "it is not plugged in"
            _LOG.warning("%s", error)
        except (SourceError, RuntimeError) as error:
            self.state = f"it does not start: {error}"
            _LOG.warning("%s does not start: %s", self._device.name, error)
        else:
            _LOG.info("%s started in %.2f s.", session.identity, time.monotonic() - started)
            return session
        return None
