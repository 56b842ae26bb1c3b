"""A camera in the network: MJPEG over HTTP from this machine, which can drop, stall and come back."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np

PERIOD_S = 0.03


class MjpegServer:
    """Sends pictures of a moving rectangle.

    Attributes:
        frames: per connection, before it drops; None for no end.
        refused: connections that are still to be refused.
        stalled: whether it sends nothing while connections stay open.
        connections: so far, refused ones included.
    """

    def __init__(self) -> None:
        self.frames: int | None = None
        self.refused = 0
        self.stalled = False
        self.connections = 0
        owner = self

        class Handler(BaseHTTPRequestHandler):
            def log_message(self, *_: object) -> None:
                """Keep the test's output clean."""

            def do_GET(self) -> None:
                owner.answer(self)

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._ended = False
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))
        self._thread.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._server.server_port}/stream.mjpg"

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        self.connections += 1
        if self.refused:
            self.refused -= 1
            request.send_error(503)
            return
        request.send_response(200)
        request.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        request.end_headers()
        sent = 0
        while not self._ended and (self.frames is None or sent < self.frames):
            if not self.stalled:
                try:
                    request.wfile.write(_part(sent))
                except OSError:  # the reader has gone
                    return
                sent += 1
            time.sleep(PERIOD_S)

    def close(self) -> None:
        self._ended = True
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


@contextmanager
def mjpeg_server() -> Iterator[MjpegServer]:
    server = MjpegServer()
    try:
        yield server
    finally:
        server.close()


def _part(number: int) -> bytes:
    image = np.full((120, 160, 3), 60, np.uint8)
    left = 20 + number % 40
    cv2.rectangle(image, (left, 30), (left + 70, 90), (200, 180, 160), -1)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    return b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(jpeg), jpeg)
