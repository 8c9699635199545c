"""A network camera: an HTTP server that streams JPEG images (MJPEG), which ``cv2.VideoCapture`` opens like a camera."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import cv2
import numpy as np


class MjpegCamera:
    """Stream images until it is closed; usable as a context manager.

    Args:
        draw: Returns the RGB image of a number.
        fps: Images per second.
        port: The port; 0 for any that is free.

    Attributes:
        url: The address of the stream.
        number: The number of the image that is streamed next; it counts on while nobody reads.
        paused: Whether no images are sent, though the connection stays open.
        readers: Number of open connections.
    """

    def __init__(self, draw: Callable[[int], Any], fps: float = 30.0, port: int = 0) -> None:
        self.paused, self.readers, self.number = False, 0, 0
        self._over = threading.Event()
        camera = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                camera.readers += 1
                try:
                    begin, sent = time.monotonic(), 0
                    while not camera._over.wait(max(0.0, begin + sent / fps - time.monotonic())):
                        sent += 1
                        if camera.paused:
                            continue
                        image = np.ascontiguousarray(draw(camera.number)[..., ::-1])
                        camera.number += 1
                        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
                        head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                        self.wfile.write(head.encode() + data + b"\r\n")
                except OSError:  # the reader is gone
                    pass
                finally:
                    camera.readers -= 1

            def log_message(self, format: str, *args: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        self.port = self._server.server_address[1]
        self.url = f"http://127.0.0.1:{self.port}/stream.mjpg"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the stream, as if the camera were unplugged."""
        self._over.set()
        self._server.shutdown()
        self._server.server_close()

    def __enter__(self) -> MjpegCamera:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
