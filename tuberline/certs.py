"""A site's own certificate authority: one certificate per node, so that the router knows who speaks.

Private keys are files of mode 0600 in a folder of mode 0700. Nothing is overwritten unless it is asked for. Nodes get
certificates for clients only: a stolen camera certificate cannot play the router.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from conveyor.errors import ConfigError, InputError
from conveyor.extras import missing_package
from conveyor.files import cause, fault_of, replacing
from conveyor.identity import CA_FILE, Identity

try:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import (
        Encoding,
        NoEncryption,
        PrivateFormat,
        load_pem_private_key,
    )
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
except ImportError as error:
    raise ConfigError(missing_package(error, "cryptography", extra="deploy", what="making certificates")) from error

CA_KEY_FILE = "ca.key"
CA_DAYS = 3650
NODE_DAYS = 730
CLOCK_SLACK = timedelta(hours=24)
"""A field computer's clock may be a day behind before it hears the time; its certificates are valid all the same."""
LATE_DAYS = 30
"""From then on `certs show` and `doctor` warn."""


@dataclass(frozen=True, slots=True)
class CertificateInfo:
    """What a certificate file says."""

    path: Path
    common_name: str
    issuer: str
    not_before: datetime
    not_after: datetime
    hosts: tuple[str, ...]
    authority: bool

    def days_left(self, now: datetime) -> float:
        """Days until it expires; negative afterwards."""
        return (self.not_after - now).total_seconds() / 86400


def make_authority(folder: Path, *, site: str, now: datetime | None = None) -> CertificateInfo:
    """A new authority in `folder` (`ca.pem`, `ca.key`).

    Raises:
        InputError: there is one already: every certificate of the site hangs on it, so it is never replaced.
    """
    for name in (CA_FILE, CA_KEY_FILE):
        if (folder / name).exists():
            raise InputError(f"{folder / name} exists; an authority is never replaced: use another folder")
    now = now or datetime.now(UTC)
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _name(f"Tuberline site {site}"[:64])
    certificate = (
        _builder(subject, subject, key.public_key(), now, CA_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(sign_others=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    _make_private(folder)
    _write_pair(folder / CA_FILE, certificate, folder / CA_KEY_FILE, key)
    return read_certificate(folder / CA_FILE)


def issue(
    folder: Path,
    identity: Identity,
    *,
    line: str,
    hosts: Sequence[str] = (),
    days: int = NODE_DAYS,
    renew: bool = False,
    now: datetime | None = None,
) -> CertificateInfo:
    """A certificate for `identity` on `line`, signed by the authority in `folder`, with a new key.

    Args:
        folder: where the authority is and the new files go: `<role>.<name>.pem` and `.key`.
        identity: the node, or the role that shares it.
        line: becomes part of the common name, so that a node of one line is unknown on another.
        hosts: host names and addresses it can be reached at; the router needs at least one.
        days: how long it is valid, at most as long as the authority.
        renew: replace what is there.
        now: start of its validity; default the clock.

    Raises:
        InputError: no authority or one with less than a day left, files already there, no host for a router.
    """
    certificate_path, key_path = folder / f"{identity.stem}.pem", folder / f"{identity.stem}.key"
    if not renew and (certificate_path.exists() or key_path.exists()):
        raise InputError(f"{certificate_path} or its key exists; --renew replaces both")
    if identity.role == "router" and not hosts:
        raise InputError("the router's certificate needs the names or addresses it is reached at: give --host")
    now = now or datetime.now(UTC)
    authority, authority_key = _authority(folder)
    key = ec.generate_private_key(authority_key.curve)
    left = (authority.not_valid_after_utc - now).days
    if left < 1:
        raise InputError(
            f"the authority {folder / CA_FILE} expires on {authority.not_valid_after_utc:%Y-%m-%d}, and its "
            "certificates with it: make a new one with all of them in another folder (certs make)"
        )
    certificate = (
        _builder(_name(identity.common_name(line)), authority.subject, key.public_key(), now, min(days, left))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(sign_others=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(_purposes(identity)), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()),
            critical=False,
        )
    )
    if hosts:
        certificate = certificate.add_extension(x509.SubjectAlternativeName([_host(h) for h in hosts]), critical=False)
    _write_pair(certificate_path, certificate.sign(authority_key, hashes.SHA256()), key_path, key)
    return read_certificate(certificate_path)


def read_certificate(path: Path) -> CertificateInfo:
    """What the certificate at `path` says.

    Raises:
        InputError: not there, or no PEM certificate.
    """
    certificate = _load(path)
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        hosts = tuple(str(name.value) for name in names)
    except x509.ExtensionNotFound:
        hosts = ()
    try:
        authority = certificate.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    except x509.ExtensionNotFound:
        authority = False
    return CertificateInfo(
        path=path,
        common_name=_common_name(certificate.subject),
        issuer=_common_name(certificate.issuer),
        not_before=certificate.not_valid_before_utc,
        not_after=certificate.not_valid_after_utc,
        hosts=hosts,
        authority=bool(authority),
    )


def _load(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as error:
        raise InputError(f"certificate {path} cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"{path} is not a PEM certificate: {str(error).splitlines()[0]}") from error


def _authority(folder: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    key_path = folder / CA_KEY_FILE
    try:
        key = load_pem_private_key(key_path.read_bytes(), password=None)
    except OSError as error:
        raise InputError(f"authority key {key_path} cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise InputError(f"{key_path} is not a PEM private key") from error
    authority = _load(folder / CA_FILE)
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != authority.public_key():
        raise InputError(f"{key_path} is not the key of {folder / CA_FILE}")
    return authority, key


def _builder(
    subject: x509.Name, issuer: x509.Name, public_key: ec.EllipticCurvePublicKey, now: datetime, days: int
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_SLACK)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public_key), critical=False)
    )


def _usage(*, sign_others: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not sign_others,
        key_cert_sign=sign_others,
        crl_sign=sign_others,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _purposes(identity: Identity) -> list[x509.ObjectIdentifier]:
    client, server = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH
    return [server, client] if identity.role == "router" else [client]


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        return x509.DNSName(host)


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _common_name(name: x509.Name) -> str:
    found = name.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(found[0].value) if found else ""


def _make_private(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(0o700)
    except OSError as error:
        raise fault_of(error, f"folder {folder} cannot be made: {cause(error)}") from error


def _write_pair(
    certificate_path: Path, certificate: x509.Certificate, key_path: Path, key: ec.EllipticCurvePrivateKey
) -> None:
    _write_private(key_path, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    _write_private(certificate_path, certificate.public_bytes(Encoding.PEM))


def _write_private(path: Path, data: bytes) -> None:
    """Write with mode 0600 from the first byte on, whole or not at all."""
    try:
        with replacing(path, mode=0o600) as file:
            file.write(data)
    except OSError as error:
        raise fault_of(error, f"{path} cannot be written: {cause(error)}") from error
