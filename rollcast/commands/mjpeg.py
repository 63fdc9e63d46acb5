"""A page on this machine that shows pictures as they are made (motion JPEG)."""

import io
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Self

from PIL import Image

BOUNDARY = "frame"
PAGE = b"""<!doctype html><title>Rollcast</title>
<body style="margin:0;background:#111"><img src="stream.mjpg"
alt="forecast over the running picture"
style="width:100vw;height:100vh;object-fit:contain">"""
JPEG_QUALITY = 85


class LivePage:
    """A server for 127.0.0.1 alone, with ``/`` and ``/stream.mjpg``; a context manager.

    Parameters
    ----------
    port
        0 for a free one.

    Raises
    ------
    OSError
        When the port is taken.
    """

    def __init__(self, port: int) -> None:
        self._changed = threading.Condition()
        self._picture = b""
        self._number = 0
        self._closed = False
        page = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                page.answer(self)

            def log_message(self, format: str, *args: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        self.address = f"http://127.0.0.1:{self._server.server_address[1]}/"

    def show(self, picture: Image.Image) -> None:
        """Replace the picture that is shown."""
        buffer = io.BytesIO()
        picture.save(buffer, "JPEG", quality=JPEG_QUALITY)
        with self._changed:
            self._picture = buffer.getvalue()
            self._number += 1
            self._changed.notify_all()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        """Answer a browser; a stream until the page is closed or the browser leaves."""
        if request.path == "/":
            request.send_response(200)
            request.send_header("Content-Type", "text/html; charset=utf-8")
            request.end_headers()
            request.wfile.write(PAGE)
            return
        if request.path != "/stream.mjpg":
            request.send_error(404)
            return
        request.send_response(200)
        request.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        request.send_header("Cache-Control", "no-store")
        request.end_headers()
        shown = 0
        try:
            while (newest := self._newer(shown)) is not None:
                shown, picture = newest
                head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}"
                request.wfile.write(head.encode() + b"\r\n\r\n" + picture + b"\r\n")
        except ConnectionError:  # the browser has left
            pass

    def _newer(self, than: int) -> tuple[int, bytes] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._number > than or self._closed)
            return None if self._closed and self._number <= than else (self._number, self._picture)

    def __enter__(self) -> Self:
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *raised: object) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._server.shutdown()
        self._server.server_close()
