"""A camera in the network: MJPEG over HTTP from this machine, which can drop, stall and come back."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2

from tests.helpers.live_camera import pictures

PERIOD_S = 0.03


class MjpegServer(ThreadingHTTPServer):
    """Sends pictures of a moving rectangle."""

    daemon_threads = True
    frames: int | None = None  # per connection, before it drops; None for no end
    refused = 0  # connections that are still to be refused
    connections = 0  # so far, refused ones included
    stalled = False  # sends nothing while connections stay open
    ended = False

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/stream.mjpg"


class _Handler(BaseHTTPRequestHandler):
    server: MjpegServer

    def log_message(self, *_: object) -> None:
        """Keep the test's output clean."""

    def do_GET(self) -> None:
        server = self.server
        server.connections += 1
        if server.refused:
            server.refused -= 1
            self.send_error(503)
            return
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        sent, jpegs = 0, [cv2.imencode(".jpg", picture)[1].tobytes() for picture in pictures(40)]
        while not server.ended and (server.frames is None or sent < server.frames):
            if not server.stalled:
                jpeg = jpegs[sent % 40]
                part = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(jpeg), jpeg)
                try:
                    self.wfile.write(part)
                except OSError:  # the reader has gone
                    return
                sent += 1
            time.sleep(PERIOD_S)


@contextmanager
def mjpeg_server() -> Iterator[MjpegServer]:
    with MjpegServer(("127.0.0.1", 0), _Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield server
        finally:
            server.ended = True
            server.shutdown()
            thread.join()
