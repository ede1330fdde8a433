"""The server of a page: who is answered, in which order, and what happens to those who leave."""

from __future__ import annotations

import base64
import contextlib
import http.client
import json
import socket
import subprocess
import threading
import time
from collections.abc import Iterator

import pytest

from clplen.errors import ShapeError
from clplen.viewer import computations
from clplen.viewer.server import ADDRESS, MAX_BODY, MAX_CONNECTIONS, ViewerServer

PAGE = b"<!doctype html><title>page</title>"


class Device:
    """Computations that wait until they are let go."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.begun: list[str] = []
        self.ended: list[str] = []

    def __call__(self, request, progress):
        name = request.get("name", "")
        self.begun.append(name)
        if request.get("raise"):
            raise {"shape": ShapeError("Too small.\nmore"), "bug": KeyError("x")}[request["raise"]]
        while request.get("wait") and not self.go.wait(0.01):
            progress(0.5, "Waiting")
        progress(1.0, "Done")
        self.ended.append(name)
        return {"name": name}, [b"\0\1" + name.encode()]


def gone() -> bytes:
    raise FileNotFoundError("view.png is no longer there.")


@pytest.fixture
def computing() -> Device:
    return Device()


@pytest.fixture
def server(computing, monkeypatch) -> Iterator[ViewerServer]:
    monkeypatch.setattr(ViewerServer, "tick", 0.02)
    monkeypatch.setattr(ViewerServer, "patience", 0.2)
    monkeypatch.setattr(ViewerServer, "read_timeout", 0.5)
    monkeypatch.setattr(computations, "_WAIT", 0.02)
    with ViewerServer(PAGE, [lambda: b"zero", gone], computing) as opened:
        yield opened
        computing.go.set()


def ask(server, method="GET", route="", body=None, *, token=None, **headers):
    """Status, headers and body of an answer; None leaves a header out."""
    connection = http.client.HTTPConnection(ADDRESS, server.port, timeout=5)
    known = {"Host": f"{ADDRESS}:{server.port}"}
    if method == "POST":
        known |= {"Origin": f"http://{ADDRESS}:{server.port}", "Content-Type": "application/json"}
    known |= {name.replace("_", "-"): value for name, value in headers.items()}
    connection.putrequest(
        method,
        f"/{server.token if token is None else token}/{route}",
        skip_host=True,
        skip_accept_encoding=True,
    )
    data = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
    if data is not None and "Content-Length" not in known:
        known["Content-Length"] = str(len(data))
    for name, value in known.items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders(data)
    answer = connection.getresponse()
    text = answer.read()
    connection.close()
    return answer.status, dict(answer.getheaders()), text


def raw(server, data: bytes) -> bytes:
    """Everything that comes back for some bytes."""
    with socket.create_connection((ADDRESS, server.port), timeout=5) as client:
        client.sendall(data)
        parts = []
        with contextlib.suppress(ConnectionError):
            while part := client.recv(65536):
                parts.append(part)
    return b"".join(parts)


def request(name="a", *, page="0123456789ab", channel="picture", **words):
    return {"page": page, "channel": channel, "request": {"name": name, **words}}


def compute(server, body) -> list[dict]:
    """The lines of an answer."""
    status, _, text = ask(server, "POST", "compute", body)
    assert status == 200, text
    return [json.loads(line) for line in text.splitlines()]


def until(condition) -> None:
    end = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def test_the_page_and_its_data(server):
    status, headers, body = ask(server)
    assert (status, body) == (200, PAGE)
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-store"
    assert not [name for name in headers if name.startswith("Access-Control")]
    assert "Server" not in headers
    assert ask(server, route="data/0")[2] == b"zero"
    assert ask(server, Host=f"localhost:{server.port}")[0] == 200
    status, _, body = ask(server, route="data/1")
    assert (status, body) == (410, b"view.png is no longer there.\n")


def test_requests_that_are_refused(server, computing):
    """Each is refused as GET and, but for those of GET alone, as POST."""
    here = f"//127.0.0.1:{server.port}"
    for status, words in [
        *((404, {"token": token}) for token in ["", "x" * 32, "..", "%2e%2e"]),
        *((403, {"Host": host}) for host in ["evil.example", "127.0.0.1", "127.0.0.1:1", "", None]),
        *((403, {"Host": f"{host}:{server.port}"}) for host in ["evil.example", "[::1]"]),
        *((403, {"Origin": origin}) for origin in ["null", "http://evil.example", ""]),
        *((403, {"Origin": origin}) for origin in ["http://127.0.0.1:1", f"https:{here}"]),
        *((403, {"Sec_Fetch_Site": site}) for site in ["cross-site", "same-site"]),
    ]:
        assert ask(server, **words)[0] == status, words
        assert ask(server, "POST", "compute", request(), **words)[0] == status, words
    assert ask(server, "POST", "compute", request(), Origin=None)[0] == 403
    assert ask(server, Sec_Fetch_Site="same-origin")[0] == 200
    for method in ["PUT", "OPTIONS", "HEAD", "X"]:
        status, headers, _ = ask(server, method)
        assert status == 405
        assert "Access-Control-Allow-Origin" not in headers
    line = f"GET /{server.token}/ HTTP/1.1\r\nHost: {ADDRESS}:{server.port}\r\n"
    answer = raw(server, f"{line}Host: evil.example\r\n\r\n".encode())
    assert b" 403 " in answer.splitlines()[0]
    assert computing.begun == []


def test_paths_that_lead_nowhere(server):
    data = ("../../etc/passwd", "%2e%2e/0", "2", "-1", "00", "0/", "\u0661", "9" * 11, "0%00")
    alive = ("alive", "alive?page=short", "alive?page=0123456789ab&x=1")
    for route in ["../", "//", "compute", "index.html", *alive, *(f"data/{one}" for one in data)]:
        line = f"GET /{server.token}/{route} HTTP/1.1\r\nHost: {ADDRESS}:{server.port}\r\n\r\n"
        assert raw(server, line.encode()).splitlines()[0].split()[1] == b"404", route


def test_request_lines_that_are_none(server):
    for line in [
        "GET http://127.0.0.1/{token}/ HTTP/1.1",
        "GET {token}/ HTTP/1.1",
        "GET /{token} HTTP/1.1",
        "GET /{token}/",
        "GET /{token}/ HTTP/9.9",
        "\0\0\0",
        "GET",
        "GET /{token}/ HTTP/1.1 x",
    ]:
        head = line.format(token=server.token)
        answer = raw(server, f"{head}\r\nHost: {ADDRESS}:{server.port}\r\n\r\n".encode())
        assert PAGE not in answer
        assert server.token.encode() not in answer


def test_bodies_that_are_refused(server, computing):
    for body, headers, status in [
        (b"{", {}, 400),
        (b"[]", {}, 400),
        (b"[" * 60000, {}, 400),
        ({"page": "0123456789ab"}, {}, 400),
        (request(page="../../etc"), {}, 400),
        (request(channel="Picture!"), {}, 400),
        ({**request(), "request": []}, {}, 400),
        (request(), {"Content_Type": "text/plain"}, 415),
        (request(), {"Content_Type": None}, 415),
        (b"x" * (MAX_BODY + 1), {}, 413),
        (None, {"Content_Length": "99999999999999999999"}, 413),
        (None, {"Content_Length": "-5"}, 400),
        (None, {"Content_Length": "0x10"}, 400),
        (None, {}, 411),
        (None, {"Transfer_Encoding": "chunked"}, 400),
    ]:
        assert ask(server, "POST", "compute", body, **headers)[0] == status
        assert computing.begun == []


def test_two_lengths(server, computing):
    head = (
        f"POST /{server.token}/compute HTTP/1.1\r\nHost: {ADDRESS}:{server.port}\r\n"
        f"Origin: http://{ADDRESS}:{server.port}\r\nContent-Type: application/json\r\n"
        "Content-Length: 2\r\nContent-Length: 80\r\n\r\n{}"
    )
    assert b" 400 " in raw(server, head.encode()).splitlines()[0]
    assert computing.begun == []


def test_nothing_follows_in_the_same_connection(server):
    line = f"GET /{server.token}/ HTTP/1.1\r\nHost: {ADDRESS}:{server.port}\r\n\r\n"
    assert raw(server, (2 * line).encode()).count(b"HTTP/1.1 ") == 1


def test_a_computation(server):
    lines = compute(server, request("far"))
    assert lines[0] == {"progress": 1.0, "what": "Done"}
    assert lines[-1]["result"] == {"name": "far"}
    assert base64.b64decode(lines[-1]["blobs"][0]) == b"\0\1far"


def test_errors_are_sentences(server):
    for kind, sentence in [("shape", "Too small."), ("bug", "The computation failed (KeyError).")]:
        assert compute(server, request(**{"raise": kind}))[-1] == {"error": sentence}
        assert compute(server, request())[-1]["result"] == {"name": "a"}


def test_a_newer_request_drops_the_older_one(server, computing):
    answers: dict[str, list] = {}

    def run(name, **words):
        answers[name] = compute(server, request(name, wait=True, **words))

    threads = []
    for name, words in [("old", {}), ("mid", {}), ("other", {"channel": "depth"}), ("new", {})]:
        threads.append(threading.Thread(target=run, args=(name,), kwargs=words))
        threads[-1].start()
        time.sleep(0.1)
    computing.go.set()
    for thread in threads:
        thread.join(5)
    assert answers["old"][-1] == answers["mid"][-1] == {"dropped": True}
    assert answers["other"][-1]["result"] == {"name": "other"}
    assert answers["new"][-1]["result"] == {"name": "new"}
    assert computing.ended == ["other", "new"]


def test_too_many_wait(server, computing, monkeypatch):
    monkeypatch.setattr(computations, "MAX_WAITING", 2)
    threads = [
        threading.Thread(target=compute, args=(server, request(wait=True, page=f"{n:012}")))
        for n in range(2)
    ]
    for thread in threads:
        thread.start()
    until(lambda: computing.begun)
    time.sleep(0.1)
    assert "busy" in compute(server, request(page="f" * 12))[-1]["error"]
    computing.go.set()
    for thread in threads:
        thread.join(5)


def test_many_requests_whose_clients_are_killed(server, computing):
    body = json.dumps(request(wait=True)).encode()
    head = (
        f"POST /{server.token}/compute HTTP/1.1\r\nHost: {ADDRESS}:{server.port}\r\n"
        f"Origin: http://{ADDRESS}:{server.port}\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n\r\n"
    ).encode()
    before = threading.active_count()
    clients = []
    for n in range(60):
        client = socket.create_connection((ADDRESS, server.port), timeout=5)
        with contextlib.suppress(OSError):  # beyond the largest number of connections
            client.sendall(head + body if n % 3 else head[: n % len(head)])
        clients.append(client)
    for client in clients:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # a reset
        client.close()
    until(lambda: threading.active_count() <= before)
    computing.go.set()
    assert ask(server)[0] == 200
    assert compute(server, request("after"))[-1]["result"] == {"name": "after"}


def test_no_more_connections_than_there_is_room_for(server):
    held = [stay(server) for _ in range(MAX_CONNECTIONS)]
    with pytest.raises((ConnectionError, http.client.HTTPException)):
        ask(server)
    for client in held:
        client.close()
    until(lambda: not server.open_pages)
    assert ask(server)[0] == 200


def test_unfinished_requests_make_room_for_others(server, computing, monkeypatch):
    monkeypatch.setattr(server, "read_timeout", 60)
    page = stay(server)
    post = f"POST /{server.token}/compute HTTP/1.1\r\nHost: {ADDRESS}:{server.port}\r\n"
    post += f"Origin: http://{ADDRESS}:{server.port}\r\nContent-Type: application/json\r\n"
    starts = [
        "",
        "GET",
        f"GET /{server.token}/ HTTP/1.1\r\nX: y\r\n",
        f"{post}Content-Length: 9\r\n\r\n{{",
    ]
    slow = []
    for n in range(2 * MAX_CONNECTIONS):
        slow.append(socket.create_connection((ADDRESS, server.port), timeout=5))
        with contextlib.suppress(ConnectionError):
            slow[-1].sendall(starts[n % len(starts)].encode())
    for _ in range(3):
        assert ask(server)[2] == PAGE
    assert compute(server, request("a"))[-1]["result"] == {"name": "a"}
    assert server.open_pages == 1  # a whole request stays
    for client in (page, *slow):
        client.close()


def is_refused(client: socket.socket, data: bytes) -> bool:
    try:
        client.sendall(data)
    except ConnectionError:
        return True
    return False


def test_a_request_arrives_within_its_time_and_size(server):
    line = f"GET /{server.token}/ HTTP/1.1\r\nHost: {ADDRESS}:{server.port}\r\n".encode()
    with socket.create_connection((ADDRESS, server.port), timeout=5) as client:
        client.sendall(line)
        until(lambda: is_refused(client, b"X"))
    many = b"".join(b"X-%d: %s\r\n" % (n, b"y" * 60000) for n in range(3))
    assert PAGE not in raw(server, line + many + b"\r\n")


def stay(server) -> socket.socket:
    client = socket.create_connection((ADDRESS, server.port), timeout=5)
    line = f"GET /{server.token}/alive?page=0123456789ab HTTP/1.1\r\n"
    client.sendall(f"{line}Host: {ADDRESS}:{server.port}\r\n\r\n".encode())
    assert client.recv(100).startswith(b"HTTP/1.1 200")
    return client


def test_it_ends_when_the_last_page_is_closed(server):
    thread = threading.Thread(target=server.run)
    thread.start()
    time.sleep(0.4)
    assert thread.is_alive()  # nobody has come yet
    one, two = stay(server), stay(server)
    one.close()
    time.sleep(0.4)
    assert thread.is_alive()  # one of two tabs is left
    two.close()
    time.sleep(0.05)
    again = stay(server)  # reloaded
    time.sleep(0.4)
    assert thread.is_alive()
    again.close()
    thread.join(5)
    assert not thread.is_alive()
    with pytest.raises(ConnectionRefusedError):
        ask(server)


def test_it_goes_on_where_that_is_asked(server):
    server.keep = True
    thread = threading.Thread(target=server.run)
    thread.start()
    stay(server).close()
    time.sleep(0.5)
    assert thread.is_alive()
    server.close()
    thread.join(5)
    assert not thread.is_alive()


def test_it_listens_on_this_computer_alone(server):
    listening = subprocess.run(["ss", "-ltn"], capture_output=True, text=True, check=False).stdout
    places = [word for word in listening.split() if word.endswith(f":{server.port}")]
    assert places in ([], [f"127.0.0.1:{server.port}"])  # [] where there is no ss
    for family, address in ((socket.AF_INET, _own_address()), (socket.AF_INET6, "::1")):
        with socket.socket(family) as client:
            client.settimeout(2)
            assert client.connect_ex((address, server.port)) != 0


def _own_address() -> str:
    """An address of this computer in its network, or one where nobody is."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.2"


def test_a_port_that_is_taken_and_one_that_is_none(server):
    with socket.socket() as other:
        other.bind((ADDRESS, 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(OSError, match=f"Port {port} is used by another program"):
            ViewerServer(PAGE, [], port=port)
    for wrong in (-1, 65536):
        with pytest.raises(ValueError, match="0 to 65535"):
            ViewerServer(PAGE, [], port=wrong)
