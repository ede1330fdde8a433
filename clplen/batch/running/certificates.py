"""Certificates by which the members of a cluster know each other (TLS)."""

from __future__ import annotations

import os
import ssl
import stat
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from clplen.checks import install_advice
from clplen.errors import FormatError, warn_caller
from clplen.files import PathLike, filling

FILES = ("ca.pem", "certificate.pem", "key.pem")
MAKE = "'clplen batch --make-certificates FOLDER' makes them"
_USAGES = (  # all that x509 knows of
    "digital_signature",
    "content_commitment",
    "key_encipherment",
    "data_encipherment",
    "key_agreement",
    "key_cert_sign",
    "crl_sign",
    "encipher_only",
    "decipher_only",
)
_VALID = timedelta(days=365)
_SKEW = timedelta(days=1)  # between the clocks of two computers


@dataclass(frozen=True)
class Certificates:
    """An authority, a certificate that it signed, and the private key of that certificate.

    Attributes
    ----------
    authority, certificate, key : str
        Names of PEM files, or their text.
    """

    authority: str
    certificate: str
    key: str

    @classmethod
    def make(cls) -> Certificates:
        """New ones in memory, for all members alike.

        The authority's own key is not kept, so that it never signs another certificate.
        """
        _require_cryptography()
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric import ec

        signer, key = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
        pem = serialization.Encoding.PEM
        secret = key.private_bytes(
            pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        authority = _signed(signer, signer, is_authority=True).public_bytes(pem)
        certificate = _signed(key, signer, is_authority=False).public_bytes(pem)
        return cls(authority.decode(), certificate.decode(), secret.decode())

    @classmethod
    def read(cls, folder: PathLike) -> Certificates:
        """Those of a folder: ``ca.pem``, ``certificate.pem`` and ``key.pem``."""
        paths = [Path(folder, name).absolute() for name in FILES]
        for path in paths:
            if not path.is_file():
                raise FormatError(f"There is no {path.name} in {folder} for TLS; {MAKE}.")
        authority, certificate, key = map(str, paths)
        try:
            context = ssl.create_default_context(cafile=authority)
            context.load_cert_chain(certificate, key, password=_no_password)
        except (OSError, ValueError) as error:
            raise FormatError(
                f"The files {', '.join(FILES)} in {folder} are no certificates with their key "
                f"({getattr(error, 'reason', None) or error}); {MAKE}."
            ) from error
        for path in paths[:2]:
            begin, end = _validity(path)
            if begin > datetime.now(timezone.utc):
                raise FormatError(
                    f"{path} is not valid before {begin:%d %B %Y, %H:%M} UTC: see to the clock of "
                    f"this computer; {MAKE} anew."
                )
            if end < datetime.now(timezone.utc):
                raise FormatError(f"{path} has expired on {end:%d %B %Y}; {MAKE} anew.")
        found = cls(authority, certificate, key)
        found._check_handshake(context)
        _warn_of_readers(paths[2])
        return found

    def _check_handshake(self, client: ssl.SSLContext) -> None:
        """Refuse files with which members of a cluster would not accept each other."""
        server = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=self.authority)
        server.load_cert_chain(self.certificate, self.key)
        server.verify_mode = ssl.CERT_REQUIRED
        client.check_hostname = False  # members have one certificate, wherever they are
        there, back = ssl.MemoryBIO(), ssl.MemoryBIO()
        ends = (client.wrap_bio(back, there), server.wrap_bio(there, back, server_side=True))
        for end in ends * 2:  # each speaks twice
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                pass
            except ssl.SSLError as error:
                reason = getattr(error, "verify_message", None) or error.reason
                raise FormatError(
                    f"Members of a cluster would refuse {self.certificate} by {self.authority} "
                    f"({reason}); {MAKE} anew."
                ) from error

    def write(self, folder: PathLike) -> None:
        """Write them to a new folder; only the owner may read the key."""
        with filling(folder, durable=True) as new:
            new.chmod(stat.S_IRWXU)
            for name, text in zip(FILES, (self.authority, self.certificate, self.key), strict=True):
                with open(new / name, "x", opener=_private) as file:
                    file.write(text)


def make_certificates(folder: PathLike) -> None:
    """Make certificates for all members of a cluster, good for a year.

    Parameters
    ----------
    folder : path-like
        A new folder; it gets ``ca.pem``, ``certificate.pem`` and ``key.pem``. Whoever has the key
        runs programs as the users of the cluster: only the owner may read the files.

    Raises
    ------
    FormatError
        If the package cryptography is not installed.
    OSError
        If the folder holds something already or cannot be written.

    Examples
    --------
    >>> clplen.batch.make_certificates("certificates")
    >>> from pathlib import Path
    >>> sorted(path.name for path in Path("certificates").iterdir())
    ['ca.pem', 'certificate.pem', 'key.pem']
    """
    Certificates.make().write(folder)


def _private(path: str, flags: int) -> int:
    return os.open(path, flags, stat.S_IRUSR | stat.S_IWUSR)


def _no_password() -> str:
    raise ValueError("its key has a password, which workers cannot type")


def _warn_of_readers(key: Path) -> None:
    """Say it when other users may read a private key."""
    if os.name == "posix" and key.stat().st_mode & (stat.S_IROTH | stat.S_IWOTH):
        warn_caller(
            f"{key} can be read by every user of this computer: chmod 600 {key}.", UserWarning
        )


def _require_cryptography() -> None:
    try:
        import cryptography  # noqa: F401
    except ImportError as error:
        raise FormatError(
            f"Certificates need the package cryptography: {install_advice('batch')}."
        ) from error


def _validity(path: Path) -> tuple[datetime, datetime]:
    """Return when the validity of a certificate begins and ends."""
    _require_cryptography()
    from cryptography import x509

    found = x509.load_pem_x509_certificate(path.read_bytes())
    return found.not_valid_before_utc, found.not_valid_after_utc


def _signed(key: Any, signer: Any, *, is_authority: bool) -> Any:
    """A certificate of a key: of the authority itself, or of a member for both sides of TLS."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    now = datetime.now(timezone.utc)
    issuer, subject = (
        x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, f"clplen {role}")])
        for role in ("authority", "authority" if is_authority else "member")
    )
    usage = dict.fromkeys(_USAGES, False)
    for purpose in ("key_cert_sign", "crl_sign") if is_authority else ("digital_signature",):
        usage[purpose] = True
    of_signer = x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key())
    builder = (
        x509.CertificateBuilder(issuer, subject, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - _SKEW)
        .not_valid_after(now + _VALID)
        .add_extension(x509.BasicConstraints(is_authority, 0 if is_authority else None), True)
        .add_extension(x509.KeyUsage(**usage), True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False)
        .add_extension(of_signer, False)
    )
    return builder.sign(signer, hashes.SHA256())
