"""Network addresses and security of a Dask cluster.

Whoever can connect to a scheduler or worker of Dask can run programs as its user. Servers
therefore listen on the loopback interface by default; other addresses need a certificate or the
explicit argument ``insecure``.
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
STATUS_PAGES = f"{LOOPBACK}:0"  # Dask always starts this server; it has no pages here
_FILES = ("certificate.pem", "key.pem")
_ROLES = ("client", "scheduler", "worker")
_GREETING = 5.0  # timeout of the first message of a server in seconds
_MAX_GREETING = 1 << 20  # bytes; the first message of Dask has some hundred
_PAUSE = 0.2  # seconds between attempts to connect


@dataclass(frozen=True)
class Network:
    """Addresses and security of a cluster.

    ``host`` is the numeric address on which local servers listen (IPv6 in brackets), ``scheduler``
    the address of a running scheduler or None, ``protocol`` "tls" or "tcp".
    """

    host: str
    scheduler: str | None
    protocol: str
    security: Any

    @property
    def is_private(self) -> bool:
        """Flag that servers are accessible from this computer only."""
        return _is_loopback(self.host)

    @property
    def server(self) -> dict[str, Any]:
        """Keyword arguments for a scheduler, nanny or worker of Dask."""
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
    """Return addresses and security of a cluster; reject unauthenticated remote access."""
    if insecure and certificates is not None:
        raise ValueError(
            f"{argument('certificates')} and {argument('insecure', True)} cannot be combined: "
            "leave one of them out."
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
            f"{scheduler} does not use certificates: start the scheduler with certificates and "
            "give tls://, or leave them out."
        )
    if certificates is not None:
        if scheduler is not None and not Path(certificates).exists():
            raise FormatError(
                f"The folder {certificates} with the certificate of {scheduler} does not exist: "
                "copy it from the computer of the scheduler."
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
    with suppress(OSError):  # raised if the files in Dask's configuration are missing
        if all(security.get_connection_args(role)["ssl_context"] for role in _ROLES):
            return security
    raise ValueError(
        f"{scheduler} needs certificates: give their folder with {argument('certificates')}."
    )


def _refuse_beyond(addresses: list[str]) -> None:
    """Raise an error for remote addresses, where connections would not be authenticated."""
    for address in addresses:
        if not _is_loopback(address):
            raise ValueError(
                f"{address} is accessible from other computers, and without TLS anyone who reaches "
                f"it can run programs as you: give a folder with {argument('certificates')} and a "
                f"scheduler with tls://, or allow it with {argument('insecure', True)}."
            )


def check_reachable(network: Network) -> None:
    """Raise an error if the scheduler cannot reach a worker on this computer."""
    if network.is_private and not _is_loopback(_address_of(network.scheduler or "")[1]):
        raise ValueError(
            f"The scheduler {network.scheduler} is on another computer and has to reach this "
            f"worker: give the network address of this computer with {argument('host')}."
        )


def check_scheduler(network: Network, seconds: float = 20.0) -> None:
    """Raise an error if a scheduler does not answer or has another certificate.

    Dask's client would wait forever for a server that accepts connections and sends nothing.
    """
    _, address, port = _address_of(network.scheduler or "")
    context = network.security.get_connection_args("client").get("ssl_context")
    end = time.monotonic() + seconds
    while True:
        try:
            endpoint = (address.strip("[]"), port)
            with socket.create_connection(endpoint, _GREETING) as plain, ExitStack() as stack:
                link = stack.enter_context(context.wrap_socket(plain)) if context else plain
                greeting = link.makefile("rb").read(8)  # the length of a message
                if len(greeting) == 8 and 0 < int.from_bytes(greeting, "little") < _MAX_GREETING:
                    return
        except ssl.SSLError as error:
            raise ValueError(
                f"The server at {network.scheduler} has other certificates or none "
                f"({getattr(error, 'verify_message', None) or error.reason}): give the "
                "certificates that the scheduler was started with."
            ) from error
        except OSError:
            pass
        if time.monotonic() >= end:
            raise DeviceError(
                f"No Dask scheduler answers at {network.scheduler} within {seconds:g} s: start it "
                "with 'dask scheduler', or correct the address (tls:// with certificates)."
            )
        time.sleep(_PAUSE)


def security_of(certificates: PathLike) -> Any:
    """Return the `distributed.Security` of a folder; create a missing folder.

    A new folder gets the certificate and key of `distributed.Security.temporary`, valid for a year.
    Whoever reads the key can run programs as the users of the cluster; the folder is therefore
    readable by its owner only.

    Parameters
    ----------
    certificates : path-like
        Folder with ``certificate.pem`` and ``key.pem``, or the name of a new folder.

    Returns
    -------
    distributed.Security
        Security for scheduler, workers and clients; it requires encryption.

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
        temporary = _temporary()
        with filling(folder, durable=True) as new:
            new.chmod(0o700)
            contents = (temporary.tls_ca_file, temporary.tls_worker_key)
            for name, text in zip(_FILES, contents, strict=True):
                (new / name).touch(mode=0o600)
                (new / name).write_text(text)
    certificate, key = (str(folder / name) for name in _FILES)
    paths = {
        f"tls_{role}_{kind}": path
        for role in _ROLES
        for kind, path in (("cert", certificate), ("key", key))
    }
    result = security(require_encryption=True, tls_ca_file=certificate, **paths)
    try:
        result.get_connection_args("client")
    except (OSError, ValueError) as error:
        raise FormatError(
            f"The files {' and '.join(_FILES)} in {folder} are not a certificate and its key "
            f"({getattr(error, 'reason', None) or error}): give a new folder to create them."
        ) from error
    return result


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
        f"No Dask scheduler answers at {scheduler}, which is not a valid address: give "
        "tcp://HOST:PORT or tls://HOST:PORT."
    )


def _numeric(host: str) -> str | None:
    """Return the address of a host, IPv4 before IPv6 (in brackets); None if it is unknown."""
    addresses: list[str] = []
    with suppress(OSError, ValueError):  # names may be unknown, too long or invalid for DNS
        if host.strip("[]"):
            entries = socket.getaddrinfo(host.strip("[]"), None, type=socket.SOCK_STREAM)
            addresses = [str(entry[4][0]) for entry in entries]
    address = min(addresses, key=lambda text: ":" in text, default=None)
    return f"[{address}]" if address and ":" in address else address


def _is_loopback(address: str) -> bool:
    return ipaddress.ip_address(address.strip("[]")).is_loopback


def require_dask() -> tuple[Any, Any]:
    """Import and return the packages dask and distributed."""
    try:
        import dask
        import distributed
    except ImportError as error:
        raise FormatError(
            f"Several workers need the package distributed: {install_advice('batch')}, or leave "
            "workers at 1."
        ) from error
    return dask, distributed
