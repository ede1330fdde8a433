"""Server of a page on 127.0.0.1, which answers requests of its own page only.

The path of every request must begin with a random token. `Host` must name this server, against
DNS rebinding; `Origin` and `Sec-Fetch-Site`, if present, must be this page. Paths of requests
never refer to files.
"""

from __future__ import annotations

import base64
import errno
import hmac
import io
import json
import re
import secrets
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from clplen.reprs import printable
from clplen.viewer.computations import Computations, Compute, OvertakenError, Request, sentence_of

ADDRESS = "127.0.0.1"
MAX_BODY = 64 * 1024  # bytes of the body of a request
MAX_REQUEST = 2 * MAX_BODY  # bytes of a request with its headers
MAX_CONNECTIONS = 64  # open at a time
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src 'self'; frame-ancestors 'none'"
)
_HEADERS = {
    "Cache-Control": "no-store",
    "Connection": "close",
    "Content-Security-Policy": _POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
_PAGE = re.compile(r"page=([0-9a-zA-Z]{8,64})", re.ASCII)
_CHANNEL = re.compile(r"[a-z]{1,16}", re.ASCII)
_NUMBER = re.compile(r"data/(0|[1-9]\d{0,8})", re.ASCII)


class _RefusedError(Exception):
    """Rejection of a request, with its HTTP status."""

    def __init__(self, status: HTTPStatus) -> None:
        super().__init__(status.phrase)
        self.status = status


class ViewerServer:
    """Server of a page and its data for the browser of this computer.

    Attributes
    ----------
    url : str
        Address with the token; whoever knows it can see the page.
    """

    tick = 1.0  # interval of keep-alive messages to a page in seconds
    patience = 3.0  # seconds without a page before the server ends, so that it may be reloaded
    read_timeout = 10.0  # time limit for receiving a request in seconds

    def __init__(
        self,
        page: bytes,
        blobs: Sequence[Callable[[], bytes]],
        compute: Compute | None = None,
        *,
        port: int = 0,
        keep: bool = False,
    ) -> None:
        if not 0 <= port <= 65535:
            raise ValueError(f"port must be a number from 0 to 65535, got {port}.")
        self.page, self.blobs, self.keep = page, blobs, keep
        self.computations = None if compute is None else Computations(compute)
        self.token = secrets.token_urlsafe(24)
        self.open_pages = 0
        self.was_opened = False
        self.last_closed = time.monotonic()
        self.ended = threading.Event()
        self._lock = threading.Lock()
        try:
            self._http = _Http((ADDRESS, port), _Handler, self)
        except OSError as error:
            raise OSError(_port_sentence(port, error)) from error
        self.port = int(self._http.server_address[1])
        self.url = f"http://{ADDRESS}:{self.port}/{self.token}/"
        self._thread: threading.Thread | None = None

    def __enter__(self) -> ViewerServer:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> ViewerServer:
        """Start to answer requests in other threads."""
        self._thread = threading.Thread(
            target=self._http.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True
        )
        self._thread.start()
        return self

    def run(self) -> None:
        """Serve until the last page is closed, or, with ``keep``, until Ctrl-C."""
        if self._thread is None:
            self.start()
        try:
            while not self.ended.wait(min(self.tick, self.patience) / 4):
                idle = time.monotonic() - self.last_closed > self.patience
                if not self.keep and self.was_opened and not self.open_pages and idle:
                    return
        finally:
            self.close()

    def close(self) -> None:
        """End all computations and connections, and free the port."""
        self.ended.set()
        if self.computations is not None:
            self.computations.end()
        with self._lock:
            thread, self._thread = self._thread, None
        if thread is not None:
            self._http.shutdown()
            thread.join()
        self._http.server_close()

    def page_opened(self) -> None:
        with self._lock:
            self.open_pages += 1
            self.was_opened = True

    def page_closed(self) -> None:
        with self._lock:
            self.open_pages -= 1
            self.last_closed = time.monotonic()


def _port_sentence(port: int, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"Port {port} is used by another program: give another --port, or leave it out."
    if error.errno == errno.EACCES:
        return f"Port {port} is reserved for the system: use 1024 or above, or leave --port out."
    return f"No port of {ADDRESS} can be opened: {error.strerror}."


class _Http(ThreadingHTTPServer):
    """HTTP server with a thread for each connection."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 128
    allow_reuse_address = True

    def __init__(self, address: tuple[str, int], handler: Any, viewer: ViewerServer) -> None:
        self.viewer = viewer
        # Connection -> True while its request is being received; oldest first.
        self.is_arriving: dict[Any, bool] = {}
        self._lock = threading.Lock()
        super().__init__(address, handler)

    def server_bind(self) -> None:
        self.socket.bind(self.server_address)  # HTTPServer would look up the host name
        self.server_address = self.socket.getsockname()

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._admit(request):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread could be started
            self._forget(request)
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._forget(request)

    def _admit(self, connection: Any) -> bool:
        """Accept a connection; if all are in use, close the slowest incomplete request."""
        with self._lock:
            if len(self.is_arriving) >= MAX_CONNECTIONS:
                incomplete = (key for key, arriving in self.is_arriving.items() if arriving)
                slowest = next(incomplete, None)
                if slowest is None:
                    return False
                del self.is_arriving[slowest]
                with suppress(OSError):
                    slowest.shutdown(socket.SHUT_RDWR)
            self.is_arriving[connection] = True
        return True

    def set_arrived(self, connection: Any) -> None:
        """Protect the connection of a complete request until it is answered."""
        with self._lock:
            if connection not in self.is_arriving:
                raise ConnectionAbortedError
            self.is_arriving[connection] = False

    def _forget(self, connection: Any) -> None:
        with self._lock:
            self.is_arriving.pop(connection, None)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore errors of clients that disconnected."""


class _BoundedReader(io.RawIOBase):
    """Reader of a request with a limit of bytes and of total time."""

    def __init__(self, connection: Any, seconds: float) -> None:
        self._connection = connection
        self._seconds = seconds
        self._end = time.monotonic() + seconds
        self._left = MAX_REQUEST

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        seconds = self._end - time.monotonic()
        if seconds <= 0 or not self._left:
            raise TimeoutError
        self._connection.settimeout(seconds)
        try:
            count = self._connection.recv_into(memoryview(buffer)[: self._left])
        finally:
            self._connection.settimeout(self._seconds)  # applies to each write
        self._left -= count
        return count


class _Handler(BaseHTTPRequestHandler):
    """Handler of a request: checks, then the page, a part of its data, or a computation."""

    protocol_version = "HTTP/1.1"
    server: _Http

    def setup(self) -> None:
        super().setup()
        seconds = self.server.viewer.read_timeout
        self.connection.settimeout(seconds)
        self.rfile = io.BufferedReader(_BoundedReader(self.connection, seconds))

    def log_message(self, format: str, *args: Any) -> None:
        """Print no log."""

    def version_string(self) -> str:
        return "clplen"

    def handle_one_request(self) -> None:
        """Answer a single request per connection; ignore clients that disconnect."""
        self.close_connection = True
        try:
            self.raw_requestline = self.rfile.readline(65537)
            if len(self.raw_requestline) > 65536 or not self.raw_requestline:
                return
            if self.parse_request():
                self.close_connection = True
                self._answer()
        except (ConnectionError, TimeoutError, ValueError):
            return

    def _answer(self) -> None:
        try:
            if self.request_version == "HTTP/0.9":
                raise _RefusedError(HTTPStatus.BAD_REQUEST)
            route = self._guarded()
            if self.command == "GET":
                self._get(route)
            elif self.command == "POST":
                self._post(route)
            else:
                raise _RefusedError(HTTPStatus.METHOD_NOT_ALLOWED)
        except _RefusedError as refused:
            self._send(f"{refused}.\n".encode(), "text/plain; charset=utf-8", refused.status)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer a request that cannot be parsed, without repeating its content."""
        self.request_version = "HTTP/1.1"
        self._send(b"Bad request.\n", "text/plain; charset=utf-8", HTTPStatus(code))

    def _guarded(self) -> str:
        """Check a request, and return its path after the token."""
        viewer = self.server.viewer
        hosts = (f"{ADDRESS}:{viewer.port}", f"localhost:{viewer.port}")
        if self.headers.get_all("Host") not in [[host] for host in hosts]:
            raise _RefusedError(HTTPStatus.FORBIDDEN)
        origins = self.headers.get_all("Origin", [])
        if any(origin not in [f"http://{host}" for host in hosts] for origin in origins):
            raise _RefusedError(HTTPStatus.FORBIDDEN)
        if self.command == "POST" and len(origins) != 1:
            raise _RefusedError(HTTPStatus.FORBIDDEN)
        sites = self.headers.get_all("Sec-Fetch-Site", [])
        if any(site not in ("none", "same-origin") for site in sites):
            raise _RefusedError(HTTPStatus.FORBIDDEN)
        first, slash, route = self.path.removeprefix("/").partition("/")
        has_token = hmac.compare_digest(first.encode(), viewer.token.encode())
        if not (has_token and slash and self.path.startswith("/")):
            raise _RefusedError(HTTPStatus.NOT_FOUND)
        return route

    def _get(self, route: str) -> None:
        self.server.set_arrived(self.connection)
        viewer = self.server.viewer
        part = _NUMBER.fullmatch(route)
        alive = _PAGE.fullmatch(route.removeprefix("alive?")) if route[:6] == "alive?" else None
        if not route:
            self._send(viewer.page, "text/html; charset=utf-8")
        elif part and int(part[1]) < len(viewer.blobs):
            try:
                self._send(viewer.blobs[int(part[1])](), "application/octet-stream")
            except (OSError, ValueError) as error:
                if isinstance(error, ConnectionError | TimeoutError):
                    raise
                message = f"{printable(sentence_of(error))}\n".encode()
                self._send(message, "text/plain; charset=utf-8", HTTPStatus.GONE)
        elif alive:
            self._stay()
        else:
            raise _RefusedError(HTTPStatus.NOT_FOUND)

    def _stay(self) -> None:
        """Send keep-alive messages to a page until it is closed."""
        viewer = self.server.viewer
        viewer.page_opened()
        try:
            self._begin("text/plain; charset=utf-8")
            while not viewer.ended.wait(viewer.tick):
                self.wfile.write(b"\n")
        finally:
            viewer.page_closed()

    def _post(self, route: str) -> None:
        viewer = self.server.viewer
        if route != "compute" or viewer.computations is None:
            raise _RefusedError(HTTPStatus.NOT_FOUND)
        body = self._body()
        self.server.set_arrived(self.connection)
        request = Request((body["page"], body["channel"]))
        self._begin("application/x-ndjson")

        def progress(fraction: float, what: str) -> None:
            try:
                self._line({"progress": round(float(fraction), 4), "what": what})
            except OSError as error:  # the page was closed
                raise OvertakenError from error

        try:
            result, blobs = viewer.computations.run(request, body["request"], progress)
            parts = [base64.b64encode(blob).decode() for blob in blobs]
            self._line({"result": result, "blobs": parts})
        except OvertakenError:
            self._line({"dropped": True})
        except (ConnectionError, TimeoutError):
            raise
        except Exception as error:
            self._line({"error": sentence_of(error)})

    def _body(self) -> dict[str, Any]:
        """Read the JSON body of a request, of limited size."""
        lengths = self.headers.get_all("Content-Length", [])
        if self.headers.get_all("Transfer-Encoding") or len(lengths) > 1:
            raise _RefusedError(HTTPStatus.BAD_REQUEST)
        if not lengths:
            raise _RefusedError(HTTPStatus.LENGTH_REQUIRED)
        if not (lengths[0].isascii() and lengths[0].isdigit()):
            raise _RefusedError(HTTPStatus.BAD_REQUEST)
        if len(lengths[0]) > 9 or int(lengths[0]) > MAX_BODY:
            raise _RefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
        if self.headers.get_content_type() != "application/json":
            raise _RefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE)
        try:
            body = json.loads(self.rfile.read(int(lengths[0])))
        except (ValueError, RecursionError):
            raise _RefusedError(HTTPStatus.BAD_REQUEST) from None
        if not isinstance(body, dict):
            raise _RefusedError(HTTPStatus.BAD_REQUEST)
        page, channel, request = (body.get(name) for name in ("page", "channel", "request"))
        if not (
            isinstance(page, str)
            and _PAGE.fullmatch(f"page={page}")
            and isinstance(channel, str)
            and _CHANNEL.fullmatch(channel)
            and isinstance(request, dict)
        ):
            raise _RefusedError(HTTPStatus.BAD_REQUEST)
        return body

    def _send(self, body: bytes, kind: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self._begin(kind, status, len(body))
        if self.command != "HEAD":
            self.wfile.write(body)

    def _begin(
        self, kind: str, status: HTTPStatus = HTTPStatus.OK, length: int | None = None
    ) -> None:
        self.send_response_only(status)
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()
        self.close_connection = True

    def _line(self, message: dict[str, Any]) -> None:
        self.wfile.write(json.dumps(message).encode() + b"\n")
        self.wfile.flush()
