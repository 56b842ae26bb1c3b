"""A connection to a viewer that can be given up at once."""

from __future__ import annotations

import contextlib
import socket
import threading

CONNECT_S = 2.0
PART = 1 << 16


class Relay:
    """Passes bytes between Rerun's sender in this process and a viewer.

    Left alone with a viewer that takes nothing, the sender keeps all data and never ends. Behind a relay it sees its
    connection break as soon as we give the viewer up, and lets go.

    Raises:
        OSError: nobody listens at the viewer's address.
    """

    def __init__(self, host: str, port: int) -> None:
        self._viewer = (host, port)
        socket.create_connection(self._viewer, CONNECT_S).close()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._open: list[socket.socket] = []
        self._lock = threading.Lock()
        self.moved = 0
        threading.Thread(target=self._accept, name="viewer-relay", daemon=True).start()

    @property
    def url(self) -> str:
        """Where Rerun's sender connects to."""
        return f"rerun+http://127.0.0.1:{self._server.getsockname()[1]}/proxy"

    def cut(self) -> None:
        """Break all connections and take no new ones; safe to call twice."""
        with self._lock:
            # a thread that waits in accept() holds the socket open until it wakes
            for connection in (self._server, *self._open):
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
                connection.close()
            self._open.clear()

    def _accept(self) -> None:
        while True:
            try:
                sender, _ = self._server.accept()
            except OSError:  # cut
                return
            try:
                viewer = socket.create_connection(self._viewer, CONNECT_S)
            except OSError:  # it went away
                sender.close()
                continue
            viewer.settimeout(None)
            with self._lock:
                if self._server.fileno() < 0:
                    sender.close()
                    viewer.close()
                    return
                self._open += [sender, viewer]
            for source, target in ((sender, viewer), (viewer, sender)):
                threading.Thread(target=self._pump, args=(source, target), daemon=True).start()

    def _pump(self, source: socket.socket, target: socket.socket) -> None:
        """Copy until either end closes, then close the other one too."""
        with contextlib.suppress(OSError):
            while part := source.recv(PART):
                target.sendall(part)
                self.moved += len(part)
        for connection in (source, target):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
