"""Where the servers of a Dask cluster listen, and whom they answer.

Whoever can talk to a scheduler or worker of Dask can run programs as its user. So servers listen
on the loopback interface unless an address is named, and whatever goes beyond it needs
certificates, or the explicit word ``insecure``.
"""

from __future__ import annotations

import ipaddress
import re
import socket
import ssl
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Any

from clplen.batch.running.certificates import MAKE, Certificates
from clplen.checks import install_advice
from clplen.errors import DeviceError, FormatError
from clplen.files import PathLike

LOOPBACK = "127.0.0.1"
STATUS_PAGES = f"{LOOPBACK}:0"  # Dask always has a server for them, here without pages
_ADDRESS = re.compile(r"(?:(tcp|tls)://)?(\[[^][]+\]|[^][:/@\s]+):(\d{1,5})/?")
_GREETING = 5.0  # seconds
_MAX_GREETING = 1 << 20  # bytes; those of Dask have some hundred
_PAUSE = 0.2  # seconds between two attempts to connect
_ROLES = ("client", "scheduler", "worker")


@dataclass(frozen=True)
class Network:
    """Addresses of a cluster, and how its members know each other.

    Attributes
    ----------
    host : str
        Numeric address on which servers started here listen; of IPv6 in brackets.
    scheduler : str or None
        Address of a scheduler that is there, ``tcp://`` or ``tls://`` with a numeric address; None:
        it is started here.
    protocol : str
        "tls", or "tcp" without encryption.
    security : distributed.Security
    """

    host: str
    scheduler: str | None
    protocol: str
    security: Any

    @property
    def is_private(self) -> bool:
        """Whether what listens is reached from this computer alone."""
        return _is_loopback(self.host.strip("[]"))

    @property
    def server(self) -> dict[str, Any]:
        """What a scheduler, nanny or worker of Dask is started with."""
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
    """Addresses and certificates of a cluster; refuses what strangers could reach."""
    if insecure and certificates is not None:
        raise ValueError(
            "Certificates and --insecure (insecure=True) exclude each other: leave one out."
        )
    listening = _own_address(LOOPBACK if host is None else host)
    if scheduler is None:
        protocol, reached = "tcp" if insecure else "tls", [listening]
    else:
        protocol, address, port = _address_of(scheduler)
        reached = [listening, address]
        scheduler = f"{protocol}://{_in_brackets(address)}:{port}"
    if protocol == "tls":
        security = _encrypted(scheduler, listening, certificates)
    elif certificates is not None:
        raise ValueError(
            f"{scheduler} takes no certificates: start the scheduler with them and give tls://, "
            "or leave them out."
        )
    else:
        if not insecure:
            _refuse_beyond(reached)
        security = _plain()
    return Network(_in_brackets(listening), scheduler, protocol, security)


def _encrypted(scheduler: str | None, listening: str, certificates: PathLike | None) -> Any:
    """Security by certificates: of a folder, of Dask's configuration, or in memory."""
    if certificates is not None:
        return _security(Certificates.read(certificates))
    if scheduler is None:
        _refuse_beyond([listening])
        return _security(Certificates.make())
    security = require_dask()[1].Security(require_encryption=True)
    with suppress(OSError):  # of files that Dask's configuration names and that are not there
        if all(security.get_connection_args(role)["ssl_context"] for role in _ROLES[::2]):
            return security
    raise ValueError(
        f"{scheduler} needs certificates: name their folder by --certificates (certificates=)."
    )


def _plain() -> Any:
    """Security without encryption, where Dask's configuration admits that."""
    security = require_dask()[1].Security()
    if security.require_encryption:
        raise ValueError(
            "Dask's configuration (distributed.comm.require-encryption) asks for TLS: name "
            "certificates by --certificates (certificates=), and a scheduler by tls://."
        )
    return security


def _refuse_beyond(addresses: list[str]) -> None:
    """Refuse addresses beyond this computer: nothing tells friends from strangers there."""
    for address in addresses:
        if not _is_loopback(address):
            raise ValueError(
                f"{address} is reached from beyond this computer, and without TLS whoever reaches "
                "it can run programs as you: name certificates by --certificates (certificates=; "
                f"{MAKE}), and a scheduler by tls://, or allow it by --insecure (insecure=True)."
            )


def check_reachable(network: Network) -> None:
    """Refuse a worker that its scheduler cannot reach."""
    address = _address_of(network.scheduler or "")[1]
    if network.is_private and not _is_own(address):
        raise ValueError(
            f"The scheduler {network.scheduler} is on another computer, from where it has to reach "
            "this worker: name an address of this computer by --host."
        )


def check_certificates(network: Network, seconds: float = 20.0) -> None:
    """Refuse a scheduler that does not answer, or whose certificates are others.

    Dask's own client waits without end for what takes connections and is no scheduler of Dask,
    which greets whoever connects.
    """
    place = _address_of(network.scheduler or "")[1:]
    context = network.security.get_connection_args("client").get("ssl_context")
    end = time.monotonic() + seconds
    while True:
        try:
            with socket.create_connection(place, _GREETING) as plain, ExitStack() as stack:
                link = stack.enter_context(context.wrap_socket(plain)) if context else plain
                if _is_of_dask(link.makefile("rb").read(8)):
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
                "with 'dask scheduler', or mend the address (tls:// where it has certificates)."
            )
        time.sleep(_PAUSE)


def _is_of_dask(greeting: bytes) -> bool:
    """Return whether a message begins with its own length, as those of Dask do."""
    return len(greeting) == 8 and 0 < int.from_bytes(greeting, "little") < _MAX_GREETING


def security_of(certificates: PathLike) -> Any:
    """Return the `distributed.Security` of a folder of certificates.

    Parameters
    ----------
    certificates : path-like
        Folder of `make_certificates`.

    Returns
    -------
    distributed.Security
        Of scheduler, workers and clients alike; it asks for encryption.

    Raises
    ------
    FormatError
        If a file is missing, damaged or not valid now, or the extra ``batch`` is not installed.

    Examples
    --------
    >>> clplen.batch.make_certificates("certificates")
    >>> clplen.batch.security_of("certificates").require_encryption
    True
    """
    return _security(Certificates.read(certificates))


def _security(certificates: Certificates) -> Any:
    keys = {f"tls_{role}_key": certificates.key for role in _ROLES}
    members = {f"tls_{role}_cert": certificates.certificate for role in _ROLES}
    return require_dask()[1].Security(
        require_encryption=True, tls_ca_file=certificates.authority, **keys, **members
    )


def _address_of(scheduler: str) -> tuple[str, str, int]:
    """Protocol, numeric address and port of a scheduler."""
    match = _ADDRESS.fullmatch(scheduler)
    numeric = _numeric(match[2]) if match else None
    if match is None or numeric is None or not 0 < int(match[3]) < 1 << 16:
        raise DeviceError(
            f"No Dask scheduler answers at {scheduler}, which is no address that is known here: "
            "give tcp://HOST:PORT or tls://HOST:PORT."
        )
    return match[1] or "tcp", numeric, int(match[3])


def _own_address(host: str) -> str:
    """The numeric address of this computer that a name or number means."""
    address = _numeric(host)
    if address is None or not _is_own(address):
        raise ValueError(
            f"--host (host=) is an address or name of this computer, without port, and {host!r} "
            "is none."
        )
    return address


def _numeric(host: str) -> str | None:
    """The address that a name means, IPv4 before IPv6; None if it means none."""
    found = []
    with suppress(OSError, ValueError):  # names may be unknown, too long or no text for DNS
        if host.strip("[]"):
            found = socket.getaddrinfo(host.strip("[]"), None, type=socket.SOCK_STREAM)
    return min((str(entry[4][0]) for entry in found), key=lambda text: ":" in text, default=None)


def _is_own(address: str) -> bool:
    """Whether a server can listen on an address."""
    family, kind, protocol, _, place = socket.getaddrinfo(address, 0, type=socket.SOCK_STREAM)[0]
    with suppress(OSError), socket.socket(family, kind, protocol) as probe:
        probe.bind(place)
        return True
    return False


def _is_loopback(address: str) -> bool:
    return ipaddress.ip_address(address).is_loopback


def _in_brackets(address: str) -> str:
    return f"[{address}]" if ":" in address else address


def require_dask() -> tuple[Any, Any]:
    """The packages dask and distributed."""
    try:
        import dask
        import distributed
    except ImportError as error:
        raise FormatError(
            f"Several workers need the package distributed: {install_advice('batch')}, or leave "
            "workers at 1."
        ) from error
    return dask, distributed
