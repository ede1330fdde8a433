"""Certificates of a cluster."""

from __future__ import annotations

import os
import shutil
import ssl
import stat
import sys
from datetime import timedelta
from pathlib import Path

import pytest
from click.testing import CliRunner

from clplen.batch import make_certificates, security_of
from clplen.batch.running import certificates
from clplen.batch.running.certificates import FILES, Certificates
from clplen.cli import main
from clplen.errors import FormatError

pytest.importorskip("distributed", reason="the extra batch is not installed")
pytest.importorskip("cryptography", reason="the extra batch is not installed")
posix = pytest.mark.skipif(os.name != "posix", reason="modes of files are those of POSIX")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "certificates"
    make_certificates(made)
    return made


@posix
@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077])
def test_only_the_owner_reads_the_key(tmp_path: Path, mask: int):
    before = os.umask(mask)
    try:
        make_certificates(tmp_path / "c")
    finally:
        os.umask(before)
    modes = {name: stat.S_IMODE((tmp_path / "c" / name).stat().st_mode) for name in FILES}
    assert modes == dict.fromkeys(FILES, 0o600)
    assert stat.S_IMODE((tmp_path / "c").stat().st_mode) == 0o700


def test_on_the_command_line(tmp_path: Path):
    """A folder that holds something already stays as it is."""
    folder = tmp_path / "c"
    made = CliRunner().invoke(main, ["batch", "--make-certificates", str(folder)])
    assert made.exit_code == 0, made.output
    assert "whoever has its key.pem can run programs as you" in made.output
    key = (folder / "key.pem").read_bytes()
    again = CliRunner().invoke(main, ["batch", "--make-certificates", str(folder)])
    assert again.exit_code == 1
    assert "is there already and not empty: name a new folder" in again.output
    assert (folder / "key.pem").read_bytes() == key


def test_the_authority_signed_the_certificate(folder: Path):
    """By the strict rules of newer Pythons too."""
    from cryptography import x509

    authority, member = (
        x509.load_pem_x509_certificate((folder / name).read_bytes()) for name in FILES[:2]
    )
    member.verify_directly_issued_by(authority)
    keys = [pem.public_key().public_numbers() for pem in (authority, member)]
    assert keys[0] != keys[1]
    assert security_of(folder).get_connection_args("worker")["require_encryption"]


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_missing_or_damaged(folder: Path, name: str):
    content = (folder / name).read_text()
    for wrong in ("", content[: len(content) // 2], "no PEM\n"):
        (folder / name).write_text(wrong)
        with pytest.raises(FormatError, match="are no certificates with their key"):
            Certificates.read(folder)
    (folder / name).unlink()
    with pytest.raises(FormatError, match=f"There is no {name} in .*--make-certificates FOLDER"):
        Certificates.read(folder)


def test_the_key_of_others(folder: Path, tmp_path: Path):
    make_certificates(tmp_path / "others")
    shutil.copy(tmp_path / "others" / "key.pem", folder / "key.pem")
    with pytest.raises(FormatError, match="are no certificates with their key"):
        Certificates.read(folder)


def test_a_key_with_a_password_is_not_asked_for(folder: Path):
    from cryptography.hazmat.primitives import serialization

    key = serialization.load_pem_private_key((folder / "key.pem").read_bytes(), None)
    locked = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(b"secret"),
    )
    (folder / "key.pem").write_bytes(locked)
    with pytest.raises(FormatError, match="its key has a password, which workers cannot type"):
        Certificates.read(folder)


def test_certificates_that_have_expired(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(certificates, "_VALID", timedelta(hours=-1))
    make_certificates(tmp_path / "old")
    with pytest.raises(FormatError, match=r"ca\.pem has expired on .* makes them anew"):
        Certificates.read(tmp_path / "old")


def test_certificates_that_are_not_valid_yet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Not an advice to try fewer workers."""
    monkeypatch.setattr(certificates, "_SKEW", timedelta(hours=-2))
    make_certificates(tmp_path / "new")
    with pytest.raises(FormatError, match=r"ca\.pem is not valid before .* UTC: see to the clock"):
        Certificates.read(tmp_path / "new")


def test_certificates_of_another_authority(folder: Path, tmp_path: Path):
    make_certificates(tmp_path / "others")
    shutil.copy(tmp_path / "others" / "ca.pem", folder / "ca.pem")
    with pytest.raises(FormatError, match=r"would refuse .*certificate\.pem by .*ca\.pem \(\w+"):
        Certificates.read(folder)


@posix
def test_a_key_that_others_read_is_said(folder: Path):
    (folder / "key.pem").chmod(0o644)
    with pytest.warns(UserWarning, match=r"key\.pem can be read by every user .*: chmod 600"):
        Certificates.read(folder)


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "cryptography", None)
    with pytest.raises(FormatError, match=r'pip install "clplen\[batch\]"'):
        make_certificates(tmp_path / "c")
    assert list(tmp_path.iterdir()) == []


def test_new_ones_are_new():
    first, second = Certificates.make(), Certificates.make()
    assert first.key != second.key
    context = ssl.create_default_context(cadata=first.authority)
    assert context.get_ca_certs()[0]["subject"] == ((("commonName", "clplen authority"),),)
