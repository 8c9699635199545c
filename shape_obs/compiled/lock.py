"""A lock that lets one process compile at a time."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import IO, Final

from shape_obs.compiled.cache import cache_folder

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

_POLL: Final = 0.1  # seconds
_PATIENCE: Final = 300.0  # seconds to wait for another process, which may hang


@contextlib.contextmanager
def exclusive(wait: Callable[[], None]) -> Iterator[None]:
    """Keep other processes from compiling.

    The operating system releases the lock of a process that is killed. Files are written as a whole, so where there
    are no locks, as on some network file systems, functions are compiled more than once and nothing else happens.

    Args:
        wait: Called once if another process holds the lock.
    """
    folder = cache_folder()
    with contextlib.ExitStack() as stack:
        try:
            file = stack.enter_context(open(folder / "lock", "a+b")) if folder else None
        except OSError:  # another user's
            file = None
        if file and _taken(file, wait):
            stack.callback(_release, file)
        yield


def _taken(file: IO[bytes], wait: Callable[[], None]) -> bool:
    """Wait for the lock; return whether it was taken, since there may be none on this file system."""
    held = _try(file)
    if held is False:
        wait()
    deadline = time.monotonic() + _PATIENCE
    while held is False and time.monotonic() < deadline:
        time.sleep(_POLL)
        held = _try(file)
    return bool(held)


def _try(file: IO[bytes]) -> bool | None:
    """Return whether the lock was taken, None where the file system has no locks."""
    try:
        if sys.platform == "win32":
            file.seek(0)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # of this process alone: a forked child does not hold it
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return None
    return True


def _release(file: IO[bytes]) -> None:
    if sys.platform == "win32":
        file.seek(0)
        msvcrt.locking(file.fileno(), msvcrt.LK_UNLCK, 1)
    else:
        fcntl.lockf(file, fcntl.LOCK_UN)
