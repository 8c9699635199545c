"""The thread that reads frames, finds the shapes in them and draws the picture that all pages show."""

from __future__ import annotations

import threading
from collections import deque
from typing import Final, Literal

from shape_obs.recording.format import Moment
from shape_obs.source import EndOfSource, FrameTimeout, RGBDSource, SourceError
from shape_obs.tuner.pictures import encode, overlay
from shape_obs.tuner.player import Player
from shape_obs.tuner.result import Finder, Result
from shape_obs.tuner.session import Session
from shape_obs.utils.timing import CLOCK, Clock

State = Literal["starting", "playing", "paused", "ended", "waiting", "lost", "released"]

_FASTEST: Final = 1 / 30  # seconds from one frame of a recording to the next
_SLOWEST: Final = 0.5
_TIMEOUT: Final = 0.5  # seconds without a frame, after which the page says that none comes
_RETRY: Final = 1.0  # seconds between attempts to find a lost camera
_SMOOTH: Final = 0.8  # of the times shown


class Engine:
    """Play a source for the pages: one thread, whose newest result and picture everyone reads.

    While no page is open nothing is computed. A camera is then released after ``patience`` seconds, and opened again
    when a page is opened.

    Args:
        source: The source; the thread connects and disconnects it.
        session: The settings.
        patience: Seconds without a page, after which a camera is released.
        clock: Time, and the ways to wait for it.

    Attributes:
        result: The newest result; None before the first frame.
        jpeg: Its picture, as a JPEG.
        state: What the source does.
        message: Why it is waiting, lost or stopped; empty if all is well.
        playing: Whether frames follow each other by themselves.
        position: Index of the frame that is shown; see ``Player``.
        latencies: Milliseconds by stage, smoothed.
    """

    def __init__(self, source: RGBDSource, session: Session, *, patience: float = 5.0, clock: Clock = CLOCK) -> None:
        self.session, self.player, self._clock = session, Player(source), clock
        self.result: Result | None = None
        self.jpeg = b""
        self.state: State = "starting"
        self.message = ""
        self.playing = bool(source.live) or session.rule is not None  # else wait for the first click
        self.position = -1
        self.latencies: dict[str, float] = {}
        self._patience, self._pages, self._alone_since = patience, 0, self._clock.now()
        self._times: deque[float] = deque(maxlen=60)
        self._wake = threading.Condition()
        self._over, self._target, self._due = False, -1, 0.0
        self._moment: Moment | None = None
        self._is_open, self._failure = threading.Event(), None
        session.on_change = self._notify
        self._thread = threading.Thread(target=self._run, name="tuner", daemon=True)

    @property
    def live(self) -> bool:
        """Whether the source is a camera, whose frames pass by."""
        return bool(self.player.source.live)

    @property
    def number(self) -> int:
        """Number of the newest result, 0 before the first."""
        return 0 if self.result is None else self.result.number

    @property
    def updates_per_second(self) -> float:
        """How many results there were in the last two seconds, per second."""
        since = self._clock.now() - 2.0
        return sum(moment > since for moment in list(self._times)) / 2.0

    def start(self) -> None:
        """Open the source and show its first frame.

        Raises:
            SourceError: It cannot be opened.
        """
        self._thread.start()
        self._is_open.wait()
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Release the source and end the thread."""
        with self._wake:
            self._over = True
            self._wake.notify_all()
        if self._thread.is_alive():
            self._thread.join(10.0)

    def open_page(self) -> None:
        """Count one more page."""
        with self._wake:
            self._pages += 1
            self._wake.notify_all()

    def close_page(self) -> None:
        """Count one page less."""
        with self._wake:
            self._pages -= 1
            self._alone_since = self._clock.now()
            self._wake.notify_all()

    def play(self) -> None:
        """Let frames follow each other; from the start if the recording has ended."""
        with self._wake:
            if self.state == "ended":
                self._target = 0
            self.player.to_newest()
            self.playing = True
            self._wake.notify_all()

    def pause(self) -> None:
        """Keep the frame that is shown."""
        with self._wake:
            self.playing = False
            self._wake.notify_all()

    def go(self, index: int) -> None:
        """Pause and show a frame by its index."""
        with self._wake:
            self.playing, self._target = False, max(index, 0)
            self._wake.notify_all()

    def step(self, by: int) -> None:
        """Pause and go some frames on, or back if negative."""
        self.go(self.player.position + by)

    def _notify(self) -> None:
        with self._wake:
            self._wake.notify_all()

    def _run(self) -> None:
        finder = Finder(self.session)
        try:
            self.player.open()
        except Exception as error:  # noqa: BLE001 - ``start`` raises it
            self._failure = error
            self._is_open.set()
            return
        self._is_open.set()
        try:
            self._advance(finder)
            while self._wait(finder):
                if self._pages == 0:
                    self._release()
                elif self.state in ("released", "lost"):
                    self._reopen(finder)
                elif self._target >= 0:
                    self._go_to_target(finder)
                elif self.playing and self._clock.now() >= self._due:
                    self._advance(finder)
                elif not finder.is_current and self._moment is not None:
                    self._show(finder.find(self._moment))
        finally:
            if not self._over:
                self.playing, self.state = False, "lost"
                self.message = "An error in shape-obs has stopped the tuner; the terminal shows it."
            self.player.close()

    def _wait(self, finder: Finder) -> bool:
        """Wait until there is something to do; return False at the end."""
        with self._wake:
            now = self._clock.now()
            if self._over:
                return False
            if self._pages == 0:
                left = self._alone_since + self._patience - now if self.live and self.state != "released" else None
                self._clock.wait(self._wake, None if left is None else max(left, 0.0))
            elif self.state == "lost":
                while not self._over and (left := now + _RETRY - self._clock.now()) > 0:
                    self._clock.wait(self._wake, left)
            elif self._target < 0 and finder.is_current and self.state != "released":
                if not self.playing:
                    self.state = "ended" if self.state == "ended" else "paused"
                    self._clock.wait(self._wake, None)
                elif self._due > now:
                    self._clock.wait(self._wake, self._due - now)
            return not self._over

    def _release(self) -> None:
        if self.live and self.state != "released" and self._clock.now() >= self._alone_since + self._patience:
            self.player.close()
            self.state, self.message = "released", "The camera was released while no page was open."

    def _reopen(self, finder: Finder) -> None:
        try:
            self.player.close()
            self.player.open()
        except (SourceError, OSError) as error:
            self.state, self.message = "lost", str(error)
        else:
            finder.forget()
            self.state, self.message = "starting", ""

    def _go_to_target(self, finder: Finder) -> None:
        with self._wake:
            target, self._target = self._target, -1
        follows = target == self.player.position + 1
        try:
            moment = self.player.go(target)
        except EndOfSource:
            self.playing, self.state = False, "ended"
            return
        except SourceError as error:
            self.message = str(error)
            return
        if not follows:
            finder.forget()
        self.state, self.message = "playing" if self.playing else "paused", ""
        self._moment = moment
        self._show(finder.find(moment))

    def _advance(self, finder: Finder) -> None:
        """Read the next frame and process it."""
        begin, before = self._clock.now(), self._moment
        try:
            moment = self.player.next(_TIMEOUT)
        except EndOfSource as end:
            self.playing, self.state, self.message = False, "ended", str(end)
            return
        except FrameTimeout as error:
            self.state, self.message = "waiting", str(error)
            return
        except SourceError as error:
            self._fail(error)
            return
        self.state, self.message = "playing" if self.playing else "paused", ""
        self._moment = moment
        # From when the last one was due, so that late ones are caught up with.
        self._due = max(self._due, begin - _SLOWEST) + _pause(before, moment) if not self.live else 0.0
        self._show(finder.find(moment))

    def _fail(self, error: SourceError) -> None:
        """Look for a lost camera again; pass over a damaged frame of a recording."""
        self.message = str(error)
        if self.player.seekable is None:
            self.state = "lost"
        elif not self.player.skip():
            self.playing, self.state = False, "ended"

    def _show(self, result: Result) -> None:
        self.jpeg = encode(overlay(result))
        self.result = result
        self.position = self.player.position
        self._times.append(self._clock.now())
        for stage, ms in ({} if result.detection is None else result.detection.timings).items():
            before = self.latencies.get(stage, ms)
            self.latencies[stage] = _SMOOTH * before + (1 - _SMOOTH) * ms


def _pause(before: Moment | None, moment: Moment) -> float:
    """Return the seconds that a frame of a recording is shown: as long as it took when it was recorded."""
    first = None if before is None else before.frame.stamp
    second = moment.frame.stamp
    apart = _FASTEST if first is None or second is None else second - first
    return min(max(apart, _FASTEST), _SLOWEST)
