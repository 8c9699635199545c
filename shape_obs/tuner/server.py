"""The server of the page: it serves until Ctrl-C, and then leaves neither a thread nor a camera behind."""

from __future__ import annotations

import errno
import secrets
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from shape_obs.tuner.engine import Engine
from shape_obs.tuner.guard import Guard, is_local
from shape_obs.utils.errors import install_hint


@dataclass(frozen=True)
class Address:
    """Where the page is served.

    Args:
        host: Name or address of a network interface; ``"127.0.0.1"`` for this machine alone.
        port: The port; 0 for any that is free.
    """

    host: str = "127.0.0.1"
    port: int = 8600

    def bind(self) -> socket.socket:
        """Return a listening socket.

        Raises:
            OSError: The port is in use, or the host is none of this machine's.
        """
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        try:
            return socket.create_server((self.host, self.port), family=family)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise OSError(
                    f"port {self.port} is in use, perhaps by another `shape-obs tune`: close it, or give another one, "
                    f"--port {self.port + 1}."
                ) from error
            raise OSError(f"cannot serve at {self.host}:{self.port}: {error.strerror or error}.") from error


def serve(
    engine: Engine, save_path: Path, host: str, listening: socket.socket, on_ready: Callable[[str], None]
) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Args:
        engine: Started; the caller stops it.
        save_path: The file that the page's button Save writes.
        host: Of the address that the socket is bound to.
        listening: The socket, which the caller closes.
        on_ready: Called with the URL when the page can be opened.

    Raises:
        ImportError: NiceGUI is not installed; the extra ``tune`` installs it.
        KeyboardInterrupt: The signal that ended it.
    """
    try:
        import uvicorn
        from fastapi import FastAPI
        from nicegui import ui
    except ImportError as error:
        raise ImportError(f"the page of `shape-obs tune` needs NiceGUI: {install_hint('tune')}") from error
    from shape_obs.tuner.page import add_page

    port = listening.getsockname()[1]
    token = None if is_local(host) else secrets.token_urlsafe(16)
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    add_page(app, engine, save_path, lambda: server.should_exit)
    ui.run_with(app, title="shape-obs tune", favicon="🪢", reconnect_timeout=3.0, show_welcome_message=False)
    config = uvicorn.Config(
        Guard(app, token, port), log_level="critical", access_log=False, timeout_graceful_shutdown=1, lifespan="on"
    )
    server = uvicorn.Server(config)
    config.load()
    name = host if is_local(host) else _reachable(host)
    url = f"http://{f'[{name}]' if ':' in name else name}:{port}/{'' if token is None else f'?token={token}'}"
    on_ready(url)
    server.run(sockets=[listening])


def _reachable(host: str) -> str:
    """Return an address under which other machines find this one."""
    if host not in ("0.0.0.0", "::"):
        return host
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing: it asks which interface leads out
            return str(probe.getsockname()[0])
        except OSError:
            return socket.gethostname()


def open_browser(url: str) -> None:
    """Open the page in the user's browser, if there is one."""
    import webbrowser

    try:
        webbrowser.open(url)
    except webbrowser.Error as error:
        print(f"shape-obs tune: no browser was opened: {error}", file=sys.stderr)
