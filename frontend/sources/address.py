"""What a server says of the file behind an http URL."""

from __future__ import annotations

import base64
from http.client import HTTPException, HTTPResponse
from pathlib import PurePosixPath
from urllib.parse import unquote, urlsplit
from urllib.request import Request, urlopen

from frontend.sources import kinds

_TIMEOUT_S = 5.0
_PLAYLISTS = (".m3u8", ".mpd")  # live ones are files, too, but no videos
_FILES = frozenset({".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".ts", ".m2ts", ".mts", ".flv", ".mpg", ".ogv"})


def length_of(url: str) -> int | None:
    """Bytes of a file; 0 where the server does not say, but the name is a file's; None for a stream, or no answer."""
    if not url.startswith(("http://", "https://")):
        return None
    try:
        suffix = PurePosixPath(urlsplit(url).path).suffix.lower()
        if suffix in _PLAYLISTS:
            return None
        with _ask(url, "HEAD") as answer:
            kind = answer.headers.get_content_type()
            length = int(answer.headers.get("Content-Length", 0))
    except (OSError, ValueError, HTTPException):  # many cameras do not answer
        return None
    if "mpegurl" in kind or "dash" in kind or kind.startswith("multipart/"):
        return None
    return length or (0 if suffix in _FILES else None)


def start_of(url: str) -> bytes:
    """What a file begins with, see `kinds.start_from`; nothing where it cannot be fetched."""
    try:
        with _ask(url, "GET") as answer:
            return kinds.start_from(answer.read)
    except (OSError, ValueError, HTTPException):
        return b""


def _ask(url: str, method: str) -> HTTPResponse:
    parts = urlsplit(url)
    user, _, host = parts.netloc.rpartition("@")
    request = Request(parts._replace(netloc=host).geturl(), method=method)
    if user:
        request.add_header("Authorization", f"Basic {base64.b64encode(unquote(user).encode()).decode()}")
    answer: HTTPResponse = urlopen(request, timeout=_TIMEOUT_S)
    return answer
