"""A folder of keys: the authority of a swarm, and for each host
a certificate that the authority has signed.

    keys/authority/   certificate.pem, key.pem                    stays on one machine
    keys/<host>/      certificate.pem, key.pem, authority.pem     for this host only

A certificate names its host (common name) and no address: a host may move without new keys.
If a host is removed, the others get a new authority and new certificates. Therefore no list of
revoked certificates is needed.
X.509 (RFC 5280), keys on the curve P-256.
"""

import datetime
import os
import re
import shutil
import stat
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from crazychoir.bus.network import CERTIFICATE_DAYS
from crazychoir.errors import ConfigError
from crazychoir.runtime.clock import date_and_time


@dataclass(frozen=True, slots=True)
class KeyFiles:
    """Names of the folder of the authority, and of the files in the folder of a host."""

    authority_folder: str = "authority"
    """Name of the authority's folder."""
    certificate: str = "certificate.pem"
    """File with the certificate."""
    private_key: str = "key.pem"
    """File with the private key."""
    authority_certificate: str = "authority.pem"
    """File with the authority's certificate, in the folder of a host."""


KEY_FILES = KeyFiles()


CLOCK_TOLERANCE = datetime.timedelta(minutes=5)
"""Difference between the clocks of two hosts that a new certificate tolerates."""
HOST_NAME = re.compile(r"[a-z0-9_-]{1,40}")
"""Name of a host."""
_COPY_AGAIN_ADVICE = "Copy the folder of this host again from the machine of the authority, or make it anew there."

_RENEW_COMMANDS = "crazychoir keys init, then crazychoir keys add HOST for each"


@dataclass(frozen=True)
class CertifiedHost:
    """A host with a certificate."""

    name: str
    """Name of the host."""
    until: datetime.datetime
    """End of its certificate's validity."""


def make_authority(folder: Path, days: int = CERTIFICATE_DAYS) -> Path:
    """Make an authority and return the path of its certificate.

    Raises ConfigError if there is one.
    """
    own = folder / KEY_FILES.authority_folder
    if own.exists():
        do = f"Add hosts to it (crazychoir keys add HOST), or remove {folder} and begin anew."
        raise ConfigError(
            str(own), "an authority", "none yet", do, "it is not replaced"
        )
    return _issue_certificate(own, f"crazychoir {os.urandom(4).hex()}", None, days)


def add_host(folder: Path, host: str, days: int = CERTIFICATE_DAYS) -> Path:
    """Make a certificate for a host and return the folder to copy there.

    Raises ConfigError for a wrong name, or if the host has a certificate.
    """
    if not HOST_NAME.fullmatch(host) or host == KEY_FILES.authority_folder:
        raise ConfigError(
            "host",
            host,
            f"1 to 40 of a-z, 0-9, _ and -, but not {KEY_FILES.authority_folder}",
        )
    if (folder / host).exists():
        do = f"Use that, or take it out first: crazychoir keys revoke {host}"
        raise ConfigError(str(folder / host), "a certificate", "none yet", do)
    _make_host_certificate(folder, host, days)
    return folder / host


def revoke_host(folder: Path, host: str, days: int = CERTIFICATE_DAYS) -> list[str]:
    """Remove a host: the others get a new authority and new certificates. Return their names.

    The folder is replaced as a whole: after an error it is as before.
    Raises ConfigError if the host has no certificate.
    """
    names = [holder.name for holder in certified_hosts(folder)]
    if host not in names:
        raise ConfigError(
            "host",
            host,
            f"a host with a certificate: {', '.join(names) or 'there is none'}",
        )
    names.remove(host)
    folder = folder.resolve()
    new = folder.with_name(f".{folder.name}.new")
    old = folder.with_name(f".{folder.name}.old")
    for left in (new, old):
        shutil.rmtree(left, ignore_errors=True)
    make_authority(new, days)
    for name in names:
        _make_host_certificate(new, name, days)
    folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old)
    return names


def certified_hosts(folder: Path) -> list[CertifiedHost]:
    """Return the hosts with a certificate, by name.

    Raises ConfigError if there is no authority.
    """
    _load_authority(folder)
    found = sorted(
        path.parent
        for path in folder.glob(f"*/{KEY_FILES.certificate}")
        if path.parent.name != KEY_FILES.authority_folder
    )
    return [
        CertifiedHost(
            path.name,
            _read_certificate(path / KEY_FILES.certificate).not_valid_after_utc,
        )
        for path in found
    ]


def check_keys(folder: Path, host: str, now: datetime.datetime | None = None) -> Path:
    """Return the folder of a host if its keys are complete, consistent, valid and private.

    Other hosts check the certificate themselves and report their own reasons.
    Raises ConfigError otherwise.
    """
    own = folder / host
    now = now or date_and_time()
    certificate = _read_certificate(own / KEY_FILES.certificate)
    root = _read_certificate(own / KEY_FILES.authority_certificate)
    key = own / KEY_FILES.private_key
    try:
        mode = key.stat().st_mode
        secret = key.read_bytes()
        matches = (
            serialization.load_pem_private_key(secret, None).public_key()
            == certificate.public_key()
        )
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            str(key),
            str(error),
            "the private key of its certificate",
            _COPY_AGAIN_ADVICE,
        ) from error
    if stat.S_IMODE(mode) & 0o077:
        raise ConfigError(
            str(key),
            f"{stat.S_IMODE(mode):o}",
            "600: only its owner may read it",
            f"chmod 600 {key}",
        )
    if not matches:
        raise ConfigError(
            str(key),
            "a key of another certificate",
            "the private key of its certificate",
            _COPY_AGAIN_ADVICE,
        )
    if _distinguished_name(certificate) != host:
        raise ConfigError(
            str(own / KEY_FILES.certificate),
            f"that of {_distinguished_name(certificate)}",
            f"that of {host}",
            _COPY_AGAIN_ADVICE,
        )
    try:
        certificate.verify_directly_issued_by(root)
    except (ValueError, TypeError, InvalidSignature) as error:
        raise ConfigError(
            str(own / KEY_FILES.certificate),
            "signed by another authority",
            f"that of {KEY_FILES.authority_certificate}",
            _COPY_AGAIN_ADVICE,
        ) from error
    for path, one in (
        (own / KEY_FILES.certificate, certificate),
        (own / KEY_FILES.authority_certificate, root),
    ):
        if not one.not_valid_before_utc <= now <= one.not_valid_after_utc:
            first, last = (
                f"{day:%Y-%m-%d %H:%M}"
                for day in (one.not_valid_before_utc, one.not_valid_after_utc)
            )
            found = f"good from {first} to {last} UTC; now is {now:%Y-%m-%d %H:%M}"
            its = f"remove {folder.name}/{host}, then crazychoir keys add {host}"
            anew = (
                f"remove {folder.name}, then {_RENEW_COMMANDS}" if one is root else its
            )
            do = f"Set the clock of this host; or, where the authority is, {anew}."
            raise ConfigError(str(path), found, "a certificate that is valid now", do)
    return own


def earliest_expiry(own: Path) -> datetime.datetime:
    """Return the earliest end of validity of the certificates in a host's folder.

    Raises ConfigError if they cannot be read.
    """
    return min(
        _read_certificate(own / name).not_valid_after_utc
        for name in (KEY_FILES.certificate, KEY_FILES.authority_certificate)
    )


def _load_authority(
    folder: Path,
) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """Return the certificate and the private key of the authority.

    Raises ConfigError if they cannot be read.
    """
    own = folder / KEY_FILES.authority_folder
    if not own.exists():
        do = "Make one, once for a lab: crazychoir keys init"
        raise ConfigError(
            str(own),
            "nothing",
            "the authority of the swarm",
            do,
            "there is no authority here",
        )
    try:
        key = serialization.load_pem_private_key(
            (own / KEY_FILES.private_key).read_bytes(), None
        )
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            str(own / KEY_FILES.private_key),
            str(error),
            "a private key in PEM",
            _COPY_AGAIN_ADVICE,
        ) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ConfigError(
            str(own / KEY_FILES.private_key),
            "a key of another kind",
            "one on the curve P-256",
            _COPY_AGAIN_ADVICE,
        )
    return _read_certificate(own / KEY_FILES.certificate), key


def _make_host_certificate(folder: Path, host: str, days: int) -> None:
    """Make a certificate for a host, and copy the authority's certificate into its folder.

    Raises ConfigError if the authority's certificate has expired.
    """
    issuer = _load_authority(folder)
    until = issuer[0].not_valid_after_utc
    if until <= date_and_time():
        found = f"good until {until:%Y-%m-%d %H:%M} UTC"
        do = f"Remove {folder}, then make all anew: {_RENEW_COMMANDS}"
        raise ConfigError(
            str(folder / KEY_FILES.authority_folder / KEY_FILES.certificate),
            found,
            "a certificate that is valid now",
            do,
            "it has expired",
        )
    _issue_certificate(folder / host, host, issuer, days)
    (folder / host / KEY_FILES.authority_certificate).write_bytes(
        issuer[0].public_bytes(serialization.Encoding.PEM)
    )


def _issue_certificate(
    folder: Path,
    name: str,
    issuer: tuple[x509.Certificate, ec.EllipticCurvePrivateKey] | None,
    days: int,
) -> Path:
    """Make a key and its certificate, and return the certificate's path.

    issuer: certificate and key of the authority; None to make an authority, which signs itself
    """
    key = ec.generate_private_key(ec.SECP256R1())
    now = date_and_time()
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    signer, secret = (
        (subject, key) if issuer is None else (issuer[0].subject, issuer[1])
    )
    last = now + datetime.timedelta(days=days)
    built = (
        x509.CertificateBuilder(
            signer, subject, key.public_key(), x509.random_serial_number()
        )
        .not_valid_before(now - CLOCK_TOLERANCE)
        .not_valid_after(
            last if issuer is None else min(last, issuer[0].not_valid_after_utc)
        )
        .add_extension(
            x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False
        )
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(secret.public_key()),
            critical=False,
        )
    )
    for extension, critical in (
        _AUTHORITY_EXTENSIONS if issuer is None else _host_extensions(name)
    ):
        built = built.add_extension(extension, critical)
    folder.mkdir(parents=True, mode=0o700)
    certificate = built.sign(secret, hashes.SHA256()).public_bytes(
        serialization.Encoding.PEM
    )
    (folder / KEY_FILES.certificate).write_bytes(certificate)
    text = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    with open(
        os.open(
            folder / KEY_FILES.private_key, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600
        ),
        "wb",
    ) as file:
        file.write(text)
    return folder / KEY_FILES.certificate


_AUTHORITY_EXTENSIONS: list[tuple[x509.ExtensionType, bool]] = [
    (x509.BasicConstraints(ca=True, path_length=0), True),
    (
        x509.KeyUsage(
            digital_signature=False,
            content_commitment=False,
            key_encipherment=False,
            data_encipherment=False,
            key_agreement=False,
            key_cert_sign=True,
            crl_sign=False,
            encipher_only=False,
            decipher_only=False,
        ),
        True,
    ),
]


def _host_extensions(name: str) -> list[tuple[x509.ExtensionType, bool]]:
    """Return the certificate extensions of a host.

    Both ends of a connection show their certificate. TLS requires an alternative name, although no
    peer checks it.
    """
    both = x509.ExtendedKeyUsage(
        [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    )
    alternative = x509.SubjectAlternativeName([x509.DNSName(name.replace("_", "-"))])
    return [
        (x509.BasicConstraints(ca=False, path_length=None), True),
        (both, False),
        (alternative, False),
    ]


def _read_certificate(path: Path) -> x509.Certificate:
    """Return a certificate; raise ConfigError, with advice, if it cannot be read."""
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as error:
        do = f"On the machine of the authority: crazychoir keys add {path.parent.name}; then copy {path.parent} here."
        if others := sorted(
            at.parent.name
            for at in path.parent.parent.glob(f"*/{KEY_FILES.certificate}")
        ):
            do = f"Here are keys of {', '.join(others)}. Start it on the host that the swarm file names. {do}"
        raise ConfigError(
            str(path), str(error.strerror), "a certificate in PEM", do
        ) from error
    except ValueError as error:
        raise ConfigError(
            str(path), str(error), "a certificate in PEM", _COPY_AGAIN_ADVICE
        ) from error


def _distinguished_name(certificate: x509.Certificate) -> str:
    return next(
        (
            str(name.value)
            for name in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        ),
        "no name",
    )
