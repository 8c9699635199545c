"""``shape-obs tune`` as a process: wrong usage, signals, who may connect."""

from __future__ import annotations

import os
import signal
import socket
import urllib.error
import urllib.request

import cv2
import numpy as np
import pytest
from installed import needs
from tuner_page import serving

from shape_obs.cli import main

pytestmark = needs("nicegui")


@pytest.fixture
def photo(tmp_path, blue):
    path = tmp_path / "rope.png"
    cv2.imwrite(str(path), cv2.cvtColor(blue, cv2.COLOR_RGB2BGR))
    return path


def failed(capsys, *arguments):
    """Return (exit code, stderr) of a command that ends with an error."""
    with pytest.raises(SystemExit) as stop:
        main(["tune", *map(str, arguments)])
    captured = capsys.readouterr()
    assert captured.out == ""
    return stop.value.code, captured.err


def status(url, **headers):
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=30) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def websocket_status(port, cookie=""):
    """Return the status of the answer to a websocket's handshake."""
    with socket.create_connection(("127.0.0.1", port), 30) as connection:
        lines = [
            "GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1", f"Host: 127.0.0.1:{port}",
            "Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", *([f"Cookie: {cookie}"] if cookie else []), "", "",
        ]  # fmt: skip
        connection.sendall("\r\n".join(lines).encode())
        return int(connection.recv(64).split()[1])


def test_a_port_in_use_is_one_clear_line(capsys, photo):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, error = failed(capsys, photo, "--port", port, "--no-open")
    assert code == 1
    assert error.count("\n") == 1
    assert f"port {port} is in use" in error
    assert f"--port {port + 1}" in error


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)])
def test_it_shows_the_photo_only_to_this_machine_until_a_signal_ends_it_and_frees_the_port(photo, number):
    with serving(photo) as served:
        with urllib.request.urlopen(served.url + "newest.jpg", timeout=30) as answer:
            picture = cv2.imdecode(np.frombuffer(answer.read(), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None
        assert picture.shape == (480, 640, 3)
        assert status(served.url) == 200
        assert status(served.url, Host="evil.example") == 403
        assert status(served.url + "newest.jpg", Origin="http://evil.example") == 403
        assert websocket_status(served.port) == 101
        served.process.send_signal(number)
        assert served.process.wait(20) == 128 + number
        assert served.process.stderr is not None
        assert served.process.stderr.read().count("\n") == 1
    with socket.create_server(("127.0.0.1", served.port)):
        pass


def test_another_host_needs_the_token(photo):
    with serving(photo, "--host", "0.0.0.0") as served:
        port, token = served.port, served.url.partition("?token=")[2]
        assert len(token) >= 16
        local = f"http://127.0.0.1:{port}/"
        for page in ("", "newest.jpg", "stage/mask/1.jpg", "_nicegui_ws/socket.io/?EIO=4&transport=polling"):
            assert status(local + page) == 403
        assert status(f"{local}?token=wrong") == 403
        assert websocket_status(port) == 403
        assert status(f"{local}?token={token}") == 200
        cookie = f"shape_obs_tune_{port}={token}"
        assert status(local + "newest.jpg", Cookie=cookie) == 200
        assert websocket_status(port, cookie) == 101
