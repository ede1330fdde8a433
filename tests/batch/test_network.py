"""Where workers listen, and who is refused."""

from __future__ import annotations

import asyncio
import ipaddress
import os
import re
import socket
import ssl
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import batchworks
import listening
import pytest

from clplen.batch import Job, security_of
from clplen.batch.running.cluster import local_cluster, worker_command
from clplen.batch.running.network import check_scheduler, network_of
from clplen.compute.device import Device
from clplen.errors import DeviceError, FormatError

distributed = pytest.importorskip("distributed", reason="the extra batch is not installed")
pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::UserWarning"
)
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc of Linux")
OWN = listening.own_address()
ANSWERED = "answered, and did not do it"
# What a configuration of Dask could lead astray.
ASTRAY = {
    "DASK_SCHEDULER_ADDRESS": f"tcp://{OWN}:9",
    "DASK_DISTRIBUTED__SCHEDULER__CONTACT_ADDRESS": f"tcp://{OWN}:9",
    "DASK_DISTRIBUTED__COMM__DEFAULT_SCHEME": "ws",
    "DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "False",
}


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the friends."""
    folder = tmp_path_factory.mktemp("friends") / "certificates"
    security_of(folder)
    return folder


@pytest.fixture(scope="module")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Security of others, made in the same way."""
    return security_of(tmp_path_factory.mktemp("strangers") / "certificates")


@pytest.fixture(scope="module")
def place() -> str:
    """Of one device: where workers listen does not depend on it."""
    return Device.open().place


def test_a_folder_for_the_owner_alone(tmp_path: Path):
    """It is made once; a file that is missing, damaged or of others is refused."""
    folder, others = tmp_path / "mine", tmp_path / "others"
    before = os.umask(0)
    try:
        security_of(folder)
    finally:
        os.umask(before)
    modes = [stat.S_IMODE(path.stat().st_mode) for path in (folder, *folder.iterdir())]
    assert modes == ([0o700, 0o600, 0o600] if os.name == "posix" else modes)
    key = (folder / "key.pem").read_bytes()
    found = security_of(folder)
    assert found.get_connection_args("worker")["require_encryption"]
    assert (folder / "key.pem").read_bytes() == key
    security_of(others)
    for wrong in (key[: len(key) // 2], b"", (others / "key.pem").read_bytes(), None):
        (folder / "key.pem").unlink()
        if wrong is not None:
            (folder / "key.pem").write_bytes(wrong)
        with pytest.raises(FormatError, match=r"are not a certificate and its key .*: give a new"):
            security_of(folder)


def test_the_loopback_interface_needs_nothing():
    """It is encrypted nevertheless: other users of the computer reach it too."""
    for host in (None, "localhost", "127.1"):
        network = network_of(host=host)
        assert (network.host, network.protocol, network.is_private) == ("127.0.0.1", "tls", True)
        assert network.security.require_encryption
    outside = network_of("localhost:8786")
    assert (outside.scheduler, outside.protocol) == ("tcp://127.0.0.1:8786", "tcp")
    with suppress(OSError), socket.socket(socket.AF_INET6) as probe:
        probe.bind(("::1", 0))
        assert network_of("tcp://[::1]:1", host="::1").scheduler == "tcp://[::1]:1"
        assert network_of(host="[::1]").host == "[::1]"


@pytest.mark.parametrize("host", ["0.0.0.0", OWN])
def test_beyond_it_only_with_certificates_or_the_word(host: str, certificates: Path):
    beyond = "is accessible from other computers, and without TLS anyone who reaches it can run"
    if not host.startswith("127."):
        for words in ({"host": host}, {"host": host, "scheduler": "tcp://127.0.0.1:8786"}):
            with pytest.raises(ValueError, match=beyond):
                network_of(**words)
    encrypted = network_of(host=host, certificates=certificates)
    assert encrypted.protocol == "tls"
    assert encrypted.security.tls_ca_file == str(certificates / "certificate.pem")
    assert network_of(host=host, insecure=True).protocol == "tcp"
    assert network_of("tcp://127.0.0.1:8786", host=host, insecure=True).protocol == "tcp"


def test_a_scheduler_elsewhere(certificates: Path, tmp_path: Path):
    """A worker runs what it sends, and has to be reached from there."""
    scheduler = "198.51.100.7:8786"
    with pytest.raises(ValueError, match=r"198\.51\.100\.7 is accessible from other computers"):
        network_of(scheduler)
    with pytest.raises(ValueError, match=r"does not use certificates: start the scheduler"):
        network_of(scheduler, certificates=certificates)
    with pytest.raises(FormatError, match=r"The folder .*none with the certificate of tls"):
        network_of(f"tls://{scheduler}", certificates=tmp_path / "none")
    network = network_of(scheduler, insecure=True)
    assert (network.scheduler, network.protocol) == (f"tcp://{scheduler}", "tcp")
    with pytest.raises(ValueError, match="is on another computer and has to reach"):
        worker_command(network, None)
    worker_command(network_of(scheduler, host="0.0.0.0", insecure=True), None)


def test_addresses_that_are_none():
    for host in ("", "[]", "*", "tcp://127.0.0.1", "127.0.0.1:80", "nowhere.invalid", "x\0"):
        with pytest.raises(ValueError, match="host= must be an address or name"):
            network_of(host=host, insecure=True)
    strange = ("tcp://", "ws://127.0.0.1:1", "127.0.0.1", "tcp://127.0.0.1:99999")
    for scheduler in (*strange, "tcp://127.0.0.1:8786@x:1", "tcp://no.invalid:1", "tcp://::1:87"):
        with pytest.raises(DeviceError, match=r"No Dask scheduler answers at .*: give tcp://HOST:"):
            network_of(scheduler, insecure=True)


def test_what_excludes_each_other(certificates: Path, tmp_path: Path):
    with pytest.raises(ValueError, match="cannot be combined"):
        network_of(certificates=certificates, insecure=True)
    with pytest.raises(ValueError, match=r"tls://127\.0\.0\.1:1 needs certificates"):
        network_of("tls://127.0.0.1:1", insecure=True)
    job = Job(output="o", scenes=[{"kind": "bars"}]).relative_to(tmp_path)
    for words in ({"scheduler": "tcp://127.0.0.1:1"}, {"workers": 1}):
        with pytest.raises(ValueError, match="this job starts none"):
            job.run(host="127.0.0.1", **words)
    assert not (tmp_path / "o").exists()


def test_certificates_of_dasks_own_configuration(certificates: Path):
    import dask

    files = {"cert": str(certificates / "certificate.pem"), "key": str(certificates / "key.pem")}
    tls = {
        f"distributed.comm.tls.{role}.{word}": file
        for role in ("client", "scheduler", "worker")
        for word, file in files.items()
    }
    with dask.config.set(tls | {"distributed.comm.tls.ca-file": files["cert"]}):
        network = network_of("tls://127.0.0.1:1")
        arguments, environment = worker_command(network, None)
    assert arguments[arguments.index("--tls-key") + 1] == files["key"]
    assert environment["DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION"] == "True"


def start(stack: ExitStack, *arguments: str, log: Path, **more: str) -> subprocess.Popen[bytes]:
    """A process of Python that ends with the stack."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **more}
    with log.open("ab") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", *arguments], stdout=file, stderr=file, env=environment
        )

    def end() -> None:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(20)
        process.kill()
        process.wait()

    stack.callback(end)
    return process


def sockets_until_it_ends(
    process: subprocess.Popen[bytes], *others: subprocess.Popen[bytes]
) -> set[tuple[int, str, int]]:
    """All sockets on which a process and others listen while it runs."""
    found: set[tuple[int, str, int]] = set()
    until = time.monotonic() + 120
    while process.poll() is None and time.monotonic() < until:
        for one in (process, *others):
            found |= listening.listening(one.pid)
        time.sleep(0.05)
    return found


def beyond_loopback(found: set[tuple[int, str, int]]) -> list[tuple[int, str, int]]:
    return [entry for entry in found if not ipaddress.ip_address(entry[1]).is_loopback]


@pytest.mark.thorough
@linux
def test_two_workers_listen_on_the_loopback_interface(tmp_path: Path, place: str):
    batchworks.write_inputs(tmp_path / "in", 8)
    job = batchworks.write_job(tmp_path, more=f'device = "{place}"')
    log = tmp_path / "log.txt"
    with ExitStack() as stack:
        run = start(stack, "clplen", "batch", str(job), "--workers", "2", log=log, **ASTRAY)
        found = sockets_until_it_ends(run)
        assert run.returncode == 0, log.read_text()
    assert "8 items done" in log.read_text()
    assert len({process for process, *_ in found}) >= 3  # the job's own, and two workers
    assert beyond_loopback(found) == []


@contextmanager
def cluster_outside(folder: Path, host: str, *more: str, place: str) -> Iterator[Any]:
    """A scheduler of Dask and a worker of clplen: the address and the worker's process."""
    file = folder / "scheduler.json"
    tls = {"--certificates": ("certificate.pem", "certificate.pem", "key.pem")}.get(
        more[0] if more else ""
    )
    pems = [str(Path(more[1], name)) for name in tls] if tls else []
    words = ["--tls-ca-file", "--tls-cert", "--tls-key"]
    protocol = "tls" if more else "tcp"
    with ExitStack() as stack:
        arguments = ["distributed.cli.dask_scheduler", "--host", host, "--port", "0"]
        arguments += ["--protocol", protocol, "--no-dashboard"]
        arguments += ["--dashboard-address", "127.0.0.1:0", "--scheduler-file", str(file)]
        arguments += [word for pair in zip(words, pems, strict=False) for word in pair]
        scheduler = start(stack, *arguments, log=folder / "scheduler.txt")
        until = time.monotonic() + 60
        while not file.exists() and time.monotonic() < until:
            time.sleep(0.05)
        time.sleep(0.1)
        (address,) = set(re.findall(r'"(t\w+://[\d.]+:\d+)"', file.read_text()))
        arguments = ["clplen", "worker", address, "--host", host, "--device", place, *more]
        worker = start(stack, *arguments, log=folder / "worker.txt", **ASTRAY)
        yield address, scheduler, worker


async def _exploit(address: str, connection: dict[str, Any], canary: Path, wait: int) -> None:
    dumps = distributed.protocol.pickle.dumps
    comm = await distributed.comm.connect(address, timeout=wait, **connection)
    try:
        words = {"function": dumps(os.mkdir), "args": dumps((str(canary),)), "wait": True}
        await distributed.core.send_recv(comm, op="run", **words)
    finally:
        comm.abort()


def exploit(address: str, connection: dict[str, Any], canary: Path, *, wait: int = 20) -> str:
    """Ask a server to make a folder; what it answers instead."""
    said = ""
    try:
        asyncio.run(asyncio.wait_for(_exploit(address, connection, canary, wait), 2 * wait))
    except (OSError, TimeoutError, asyncio.TimeoutError) as error:
        said = type(error).__name__
    return "" if canary.exists() else said or ANSWERED


def attempts(strangers: Any) -> dict[str, dict[str, Any]]:
    """What someone without the certificates can do."""
    blind = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    blind.check_hostname, blind.verify_mode = False, ssl.CERT_NONE
    own = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    own.check_hostname, own.verify_mode = False, ssl.CERT_NONE
    own.load_cert_chain(strangers.tls_client_cert, strangers.tls_client_key)
    return {
        "tcp": {},
        "tls": {"ssl_context": blind},
        "tls with own certificate": {"ssl_context": own},
    }


def assert_refused(ports: list[tuple[str, int]], strangers: Any, canary: Path) -> None:
    for host, port in ports:
        for name, connection in attempts(strangers).items():
            said = exploit(f"{name[:3]}://{host}:{port}", connection, canary, wait=1)
            assert not canary.exists(), f"{name} ran code at {host}:{port}"
            assert said not in ("", ANSWERED), f"{name} is let in at {host}:{port}"


@pytest.mark.thorough
@linux
def test_strangers_are_refused_beyond_the_loopback_interface(
    tmp_path: Path, place: str, certificates: Path, strangers: Any
):
    """By scheduler, nanny and worker; who has the certificates does the job."""
    batchworks.write_inputs(tmp_path / "in", 4)
    job = batchworks.write_job(tmp_path)
    log, canary = tmp_path / "log.txt", tmp_path / "canary"
    words = ("--certificates", str(certificates))
    outside = cluster_outside(tmp_path, OWN, *words, place=place)
    with outside as (address, scheduler, worker), ExitStack() as stack:
        run = start(stack, "clplen", "batch", str(job), "--scheduler", address, *words, log=log)
        found = sockets_until_it_ends(run, scheduler, worker)
        assert run.returncode == 0, log.read_text()
        ports = sorted({(host, port) for _, host, port in found if host == OWN})
        assert len(ports) == 3
        assert_refused(ports, strangers, canary)
        friend = security_of(certificates).get_connection_args("client")
        (server,) = [p for _, h, p in listening.listening(worker.pid) if h == OWN][:1]
        assert exploit(f"tls://{OWN}:{server}", friend, canary) == ""
        assert canary.exists()
        check_scheduler(network_of(address, certificates=certificates))
        others = Path(strangers.tls_ca_file).parent
        with pytest.raises(ValueError, match="has other certificates or none"):
            check_scheduler(network_of(address, certificates=others))
    assert {host for _, host, _ in found} <= {OWN, "127.0.0.1"}


@pytest.mark.thorough
def test_who_has_the_certificate_may_join_a_job(
    tmp_path: Path, place: str, certificates: Path, strangers: Any
):
    """Where a job listens on an address that is named; others are refused."""
    canary = tmp_path / "canary"
    network = network_of(host=OWN, certificates=certificates)
    executor = local_cluster(
        tmp_path, workers=1, devices=[place], memory=None, retries=0, network=network
    )
    with executor as cluster:
        info = cluster._client.scheduler_info()
        (worker,) = info["workers"].values()
        addresses = [info["address"], worker["nanny"], *info["workers"]]
        assert all(address.startswith(f"tls://{OWN}:") for address in addresses)
        ports = [(OWN, int(address.rpartition(":")[2])) for address in addresses]
        assert_refused(ports, strangers, canary)
        friend = security_of(certificates).get_connection_args("worker")
        assert exploit(addresses[2], friend, canary) == ""
