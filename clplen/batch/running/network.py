"""Where the servers of a Dask cluster listen, and whom they answer.

Whoever can talk to a scheduler or worker of Dask can run programs as its user. So servers listen
on the loopback interface unless an address is named, and whatever goes beyond it needs
a certificate, or the explicit word ``insecure``.
"""

from __future__ import annotations

import ipaddress
import socket
import ssl
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from clplen.checks import install_advice
from clplen.errors import DeviceError, FormatError, argument
from clplen.files import PathLike, filling

LOOPBACK = "127.0.0.1"
STATUS_PAGES = f"{LOOPBACK}:0"  # Dask always has a server for them, here without pages
_FILES = ("certificate.pem", "key.pem")
_ROLES = ("client", "scheduler", "worker")
_GREETING = 5.0  # seconds
_MAX_GREETING = 1 << 20  # bytes; those of Dask have some hundred
_PAUSE = 0.2  # seconds between two attempts to connect


@dataclass(frozen=True)
class Network:
    """Addresses of a cluster, and how its members know each other.

    ``host`` is the numeric address on which servers started here listen (IPv6 in brackets);
    ``scheduler`` the address of a running scheduler, or None; ``protocol`` is "tls" or "tcp".
    """

    host: str
    scheduler: str | None
    protocol: str
    security: Any

    @property
    def is_private(self) -> bool:
        """Whether what listens is reached from this computer alone."""
        return _is_loopback(self.host)

    @property
    def server(self) -> dict[str, Any]:
        """Arguments of a scheduler, nanny or worker of Dask."""
        return {
            "host": self.host,
            "protocol": self.protocol,
            "security": self.security,
            "dashboard": False,
            "dashboard_address": STATUS_PAGES,
        }


def network_of(
    scheduler: str | None = None,
    *,
    host: str | None = None,
    certificates: PathLike | None = None,
    insecure: bool = False,
) -> Network:
    """Return addresses and security of a cluster; refuse what strangers could reach."""
    if insecure and certificates is not None:
        raise ValueError(
            f"{argument('certificates')} and {argument('insecure', True)} exclude each other: "
            "leave one out."
        )
    listening = _numeric(LOOPBACK if host is None else host)
    if listening is None:
        raise ValueError(
            f"{argument('host')} must be an address or name of this computer, without port, got "
            f"{host!r}."
        )
    protocol, reached = "tcp" if insecure else "tls", [listening]
    if scheduler is not None:
        protocol, address, port = _address_of(scheduler)
        reached.append(address)
        scheduler = f"{protocol}://{address}:{port}"
    if protocol == "tcp" and certificates is not None:
        raise ValueError(
            f"{scheduler} takes no certificates: start the scheduler with them and give tls://, "
            "or leave them out."
        )
    if certificates is not None:
        if scheduler is not None and not Path(certificates).exists():
            raise FormatError(
                f"There is no folder {certificates} with the certificate of {scheduler}: copy it "
                "from the computer of the scheduler."
            )
        security = security_of(certificates)
    elif protocol == "tls" and scheduler is not None:
        security = _configured(scheduler)
    else:
        if not insecure:
            _refuse_beyond(reached)
        security = _temporary() if protocol == "tls" else require_dask()[1].Security()
    return Network(listening, scheduler, protocol, security)


def _configured(scheduler: str) -> Any:
    """Return the security of Dask's own configuration (``distributed.comm.tls``)."""
    security = require_dask()[1].Security(require_encryption=True)
    with suppress(OSError):  # of files that Dask's configuration names and that are not there
        if all(security.get_connection_args(role)["ssl_context"] for role in _ROLES):
            return security
    raise ValueError(
        f"{scheduler} needs certificates: name their folder by {argument('certificates')}."
    )


def _refuse_beyond(addresses: list[str]) -> None:
    """Refuse addresses beyond this computer, where connections would not be authenticated."""
    for address in addresses:
        if not _is_loopback(address):
            raise ValueError(
                f"{address} is reached from beyond this computer, and without TLS whoever reaches "
                f"it can run programs as you: name a folder by {argument('certificates')}, and a "
                f"scheduler by tls://, or allow it by {argument('insecure', True)}."
            )


def check_reachable(network: Network) -> None:
    """Refuse a worker that its scheduler cannot reach."""
    if network.is_private and not _is_loopback(_address_of(network.scheduler or "")[1]):
        raise ValueError(
            f"The scheduler {network.scheduler} is on another computer, from where it has to reach "
            f"this worker: name an address of this computer by {argument('host')}."
        )


def check_scheduler(network: Network, seconds: float = 20.0) -> None:
    """Refuse a scheduler that does not answer, or whose certificate is another.

    Dask's own client waits without end for a port that takes connections and sends nothing.
    """
    _, address, port = _address_of(network.scheduler or "")
    context = network.security.get_connection_args("client").get("ssl_context")
    end = time.monotonic() + seconds
    while True:
        try:
            place = (address.strip("[]"), port)
            with socket.create_connection(place, _GREETING) as plain, ExitStack() as stack:
                link = stack.enter_context(context.wrap_socket(plain)) if context else plain
                greeting = link.makefile("rb").read(8)  # the length of a message
                if len(greeting) == 8 and 0 < int.from_bytes(greeting, "little") < _MAX_GREETING:
                    return
        except ssl.SSLError as error:
            raise ValueError(
                f"What answers at {network.scheduler} has other certificates than these, or none "
                f"({getattr(error, 'verify_message', None) or error.reason}): name those that the "
                "scheduler was started with."
            ) from error
        except OSError:
            pass
        if time.monotonic() >= end:
            raise DeviceError(
                f"No Dask scheduler answers at {network.scheduler} within {seconds:g} s: start one "
                "with 'dask scheduler', or correct the address (tls:// where it has certificates)."
            )
        time.sleep(_PAUSE)


def security_of(certificates: PathLike) -> Any:
    """Return the `distributed.Security` of a folder; make the folder if there is none.

    A new folder gets the certificate and key of `distributed.Security.temporary`, good for a year.
    Whoever reads the key can run programs as the users of the cluster, so that only the owner may
    read the folder.

    Parameters
    ----------
    certificates : path-like
        A folder with ``certificate.pem`` and ``key.pem``, or the name of a new one.

    Returns
    -------
    distributed.Security
        Security of scheduler, workers and clients alike; it requires encryption.

    Raises
    ------
    FormatError
        If a file is missing or damaged, or the extra ``batch`` is not installed.
    OSError
        If the folder cannot be written.

    Examples
    --------
    >>> security = clplen.batch.security_of("certificates")
    >>> security.require_encryption
    True
    >>> clplen.batch.security_of("certificates").tls_ca_file == security.tls_ca_file
    True
    """
    security = require_dask()[1].Security
    folder = Path(certificates).absolute()
    if not folder.exists():
        made = _temporary()
        with filling(folder, durable=True) as new:
            new.chmod(0o700)
            for name, text in zip(_FILES, (made.tls_ca_file, made.tls_worker_key), strict=True):
                (new / name).touch(mode=0o600)
                (new / name).write_text(text)
    certificate, key = (str(folder / name) for name in _FILES)
    words = {
        f"tls_{role}_{word}": path
        for role in _ROLES
        for word, path in (("cert", certificate), ("key", key))
    }
    found = security(require_encryption=True, tls_ca_file=certificate, **words)
    try:
        found.get_connection_args("client")
    except (OSError, ValueError) as error:
        raise FormatError(
            f"The files {' and '.join(_FILES)} in {folder} are no certificate with its key "
            f"({getattr(error, 'reason', None) or error}): name a new folder to make them."
        ) from error
    return found


def _temporary() -> Any:
    try:
        return require_dask()[1].Security.temporary()
    except ImportError as error:
        raise FormatError(
            f"Certificates need the package cryptography: {install_advice('batch')}."
        ) from error


def _address_of(scheduler: str) -> tuple[str, str, int]:
    """Return protocol, numeric address and port of a scheduler."""
    with suppress(ValueError):  # no port, or one beyond 65535
        parts = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
        numeric = _numeric(parts.hostname or "")
        if parts.scheme in ("tcp", "tls") and numeric and parts.port:
            return parts.scheme, numeric, parts.port
    raise DeviceError(
        f"No Dask scheduler answers at {scheduler}, which is no address that is known here: "
        "give tcp://HOST:PORT or tls://HOST:PORT."
    )


def _numeric(host: str) -> str | None:
    """Return the address of a name, IPv4 before IPv6 (in brackets); None if it has none."""
    found: list[str] = []
    with suppress(OSError, ValueError):  # names may be unknown, too long or no text for DNS
        if host.strip("[]"):
            entries = socket.getaddrinfo(host.strip("[]"), None, type=socket.SOCK_STREAM)
            found = [str(entry[4][0]) for entry in entries]
    address = min(found, key=lambda text: ":" in text, default=None)
    return f"[{address}]" if address and ":" in address else address


def _is_loopback(address: str) -> bool:
    return ipaddress.ip_address(address.strip("[]")).is_loopback


def require_dask() -> tuple[Any, Any]:
    """Return the packages dask and distributed."""
    try:
        import dask
        import distributed
    except ImportError as error:
        raise FormatError(
            f"Several workers need the package distributed: {install_advice('batch')}, or leave "
            "workers at 1."
        ) from error
    return dask, distributed
