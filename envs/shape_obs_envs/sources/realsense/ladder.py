"""Ladder: what is done, step by step, when a camera falls silent."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Final

from shape_obs.source import CameraLost, CameraNotFound, SourceError
from shape_obs_envs.sources.realsense.origins import Origin
from shape_obs_envs.sources.realsense.session import Session

_LOG: Final = logging.getLogger(__name__)
_STEPS: Final = ("wait on", "restart the pipeline", "reset the camera", "look for the camera again")
#: Seconds that a camera needs before it is gone after a reset.
_RESET: Final = 2.0


class Ladder:
    """Climbs one step at each call: wait on, restart, reset, look for it again, until the time is over.

    Args:
        origin: Where the camera comes from.
        open_session: Starts a session anew, with a new context and config.
        recover_timeout: Seconds without a frame after which the camera is lost.
        stopping: Set when nobody wants it any more.

    Attributes:
        state: What is being done, for messages; empty while frames come.
    """

    def __init__(
        self,
        origin: Origin,
        open_session: Callable[[], Session],
        recover_timeout: float,
        stopping: threading.Event,
    ) -> None:
        self._origin, self._open, self._stopping = origin, open_session, stopping
        self._recover_timeout = recover_timeout
        self._rung, self.state = 0, ""

    def frame_came(self, who: object) -> None:
        """Back to the first step."""
        if self._rung:
            _LOG.warning("%s gives frames again.", who)
        self._rung, self.state = 0, ""

    def climb(self, session: Session | None, silent: float) -> Session | None:
        """One step.

        Args:
            session: The session that gives no frames, or None.
            silent: Seconds since the last frame.

        Returns:
            The session to go on with; None while there is no camera.

        Raises:
            CameraLost: The time is over.
        """
        who = str(session.identity) if session is not None else self._origin.name
        if silent > self._recover_timeout:
            if session is not None:
                session.stop()
            raise CameraLost(
                f"{who} has given no frame for {silent:.1f} s, and neither a restart nor a reset brought it back"
                f"{self.state and f' ({self.state})'}: check the cable and its port, then connect again."
            )
        step = _STEPS[min(self._rung, len(_STEPS) - 1)]
        self._rung += 1
        self.state = f"step {min(self._rung, len(_STEPS))} of {len(_STEPS)}: {step}"
        _LOG.warning("%s has given no frame for %.1f s; %s.", who, silent, self.state)
        if self._rung == 1:
            return session
        if session is not None:
            session.stop()
        if step == "reset the camera":
            self._reset()
        return self._reopen()

    def _reset(self) -> None:
        try:
            self._origin.find().hardware_reset()
        except (RuntimeError, SourceError) as error:
            _LOG.warning("%s could not be reset: %s", self._origin.name, error)
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
            _LOG.warning("%s does not start: %s", self._origin.name, error)
        else:
            _LOG.info("%s started in %.2f s.", session.identity, time.monotonic() - started)
            return session
        return None
