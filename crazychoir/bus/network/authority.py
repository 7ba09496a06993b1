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
from crazychoir.runtime.clock import today

AUTHORITY = "authority"
"""Name of the authority's folder."""
CERTIFICATE = "certificate.pem"
"""File with the certificate."""
KEY = "key.pem"
"""File with the private key."""
ROOT = "authority.pem"
"""File with the authority's certificate, in the folder of a host."""
SLACK = datetime.timedelta(minutes=5)
"""Difference between the clocks of two hosts that a new certificate tolerates."""
NAME = re.compile(r"[a-z0-9_-]{1,40}")
"""Name of a host."""
_AGAIN = "Copy the folder of this host again from the machine of the authority, or make it anew there."

_ANEW = "crazychoir keys init, then crazychoir keys add HOST for each"


@dataclass(frozen=True)
class Holder:
    """A host with a certificate."""

    name: str
    """Name of the host."""
    until: datetime.datetime
    """End of its certificate's validity."""


def init(folder: Path, days: int = CERTIFICATE_DAYS) -> Path:
    """Make an authority and return the path of its certificate.

    Raises ConfigError if there is one.
    """
    own = folder / AUTHORITY
    if own.exists():
        do = f"Add hosts to it (crazychoir keys add HOST), or remove {folder} and begin anew."
        raise ConfigError(
            str(own), "an authority", "none yet", do, "it is not replaced"
        )
    return _issue(own, f"crazychoir {os.urandom(4).hex()}", None, days)


def add(folder: Path, host: str, days: int = CERTIFICATE_DAYS) -> Path:
    """Make a certificate for a host and return the folder to copy there.

    Raises ConfigError for a wrong name, or if the host has a certificate.
    """
    if not NAME.fullmatch(host) or host == AUTHORITY:
        raise ConfigError(
            "host", host, f"1 to 40 of a-z, 0-9, _ and -, but not {AUTHORITY}"
        )
    if (folder / host).exists():
        do = f"Use that, or take it out first: crazychoir keys revoke {host}"
        raise ConfigError(str(folder / host), "a certificate", "none yet", do)
    _give(folder, host, days)
    return folder / host


def revoke(folder: Path, host: str, days: int = CERTIFICATE_DAYS) -> list[str]:
    """Remove a host: the others get a new authority and new certificates. Return their names.

    The folder is replaced as a whole: after an error it is as before.
    Raises ConfigError if the host has no certificate.
    """
    names = [holder.name for holder in holders(folder)]
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
    init(new, days)
    for name in names:
        _give(new, name, days)
    folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old)
    return names


def holders(folder: Path) -> list[Holder]:
    """Return the hosts with a certificate, by name.

    Raises ConfigError if there is no authority.
    """
    _authority(folder)
    found = sorted(
        path.parent
        for path in folder.glob(f"*/{CERTIFICATE}")
        if path.parent.name != AUTHORITY
    )
    return [
        Holder(path.name, _read(path / CERTIFICATE).not_valid_after_utc)
        for path in found
    ]


def checked(folder: Path, host: str, now: datetime.datetime | None = None) -> Path:
    """Return the folder of a host if its keys are complete, consistent, valid and private.

    Other hosts check the certificate themselves and report their own reasons.
    Raises ConfigError otherwise.
    """
    own = folder / host
    now = now or today()
    certificate = _read(own / CERTIFICATE)
    root = _read(own / ROOT)
    key = own / KEY
    try:
        mode = key.stat().st_mode
        secret = key.read_bytes()
        matches = (
            serialization.load_pem_private_key(secret, None).public_key()
            == certificate.public_key()
        )
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            str(key), str(error), "the private key of its certificate", _AGAIN
        ) from error
    if stat.S_IMODE(mode) & 0o077:
        raise ConfigError(
            str(key),
            f"{stat.S_IMODE(mode):o}",
            "600: nobody else may read it",
            f"chmod 600 {key}",
        )
    if not matches:
        raise ConfigError(
            str(key),
            "a key of another certificate",
            "the private key of its certificate",
            _AGAIN,
        )
    if _named(certificate) != host:
        raise ConfigError(
            str(own / CERTIFICATE),
            f"that of {_named(certificate)}",
            f"that of {host}",
            _AGAIN,
        )
    try:
        certificate.verify_directly_issued_by(root)
    except (ValueError, TypeError, InvalidSignature) as error:
        raise ConfigError(
            str(own / CERTIFICATE),
            "signed by another authority",
            f"that of {ROOT}",
            _AGAIN,
        ) from error
    for path, one in ((own / CERTIFICATE, certificate), (own / ROOT, root)):
        if not one.not_valid_before_utc <= now <= one.not_valid_after_utc:
            first, last = (
                f"{day:%Y-%m-%d %H:%M}"
                for day in (one.not_valid_before_utc, one.not_valid_after_utc)
            )
            found = f"good from {first} to {last} UTC; now is {now:%Y-%m-%d %H:%M}"
            its = f"remove {folder.name}/{host}, then crazychoir keys add {host}"
            anew = f"remove {folder.name}, then {_ANEW}" if one is root else its
            do = f"Set the clock of this host; or, where the authority is, {anew}."
            raise ConfigError(str(path), found, "one that is good now", do)
    return own


def good_until(own: Path) -> datetime.datetime:
    """Return the earliest end of validity of the certificates in a host's folder.

    Raises ConfigError if they cannot be read.
    """
    return min(_read(own / name).not_valid_after_utc for name in (CERTIFICATE, ROOT))


def _authority(folder: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """Return the certificate and the private key of the authority.

    Raises ConfigError if they cannot be read.
    """
    own = folder / AUTHORITY
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
        key = serialization.load_pem_private_key((own / KEY).read_bytes(), None)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            str(own / KEY), str(error), "a private key in PEM", _AGAIN
        ) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ConfigError(
            str(own / KEY), "a key of another kind", "one on the curve P-256", _AGAIN
        )
    return _read(own / CERTIFICATE), key


def _give(folder: Path, host: str, days: int) -> None:
    """Make a certificate for a host, and copy the authority's certificate into its folder.

    Raises ConfigError if the authority's certificate has expired.
    """
    issuer = _authority(folder)
    until = issuer[0].not_valid_after_utc
    if until <= today():
        found = f"good until {until:%Y-%m-%d %H:%M} UTC"
        do = f"Remove {folder}, then make all anew: {_ANEW}"
        raise ConfigError(
            str(folder / AUTHORITY / CERTIFICATE),
            found,
            "one that is good now",
            do,
            "it has expired",
        )
    _issue(folder / host, host, issuer, days)
    (folder / host / ROOT).write_bytes(
        issuer[0].public_bytes(serialization.Encoding.PEM)
    )


def _issue(
    folder: Path,
    name: str,
    issuer: tuple[x509.Certificate, ec.EllipticCurvePrivateKey] | None,
    days: int,
) -> Path:
    """Make a key and its certificate, and return the certificate's path.

    issuer: certificate and key of the authority; None to make an authority, which signs itself
    """
    key = ec.generate_private_key(ec.SECP256R1())
    now = today()
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    signer, secret = (
        (subject, key) if issuer is None else (issuer[0].subject, issuer[1])
    )
    last = now + datetime.timedelta(days=days)
    built = (
        x509.CertificateBuilder(
            signer, subject, key.public_key(), x509.random_serial_number()
        )
        .not_valid_before(now - SLACK)
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
    for extension, critical in _OF_AUTHORITY if issuer is None else _of_host(name):
        built = built.add_extension(extension, critical)
    folder.mkdir(parents=True, mode=0o700)
    certificate = built.sign(secret, hashes.SHA256()).public_bytes(
        serialization.Encoding.PEM
    )
    (folder / CERTIFICATE).write_bytes(certificate)
    text = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    with open(
        os.open(folder / KEY, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb"
    ) as file:
        file.write(text)
    return folder / CERTIFICATE


_OF_AUTHORITY: list[tuple[x509.ExtensionType, bool]] = [
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


def _of_host(name: str) -> list[tuple[x509.ExtensionType, bool]]:
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


def _read(path: Path) -> x509.Certificate:
    """Return a certificate; raise ConfigError, with advice, if it cannot be read."""
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as error:
        do = f"On the machine of the authority: crazychoir keys add {path.parent.name}; then copy {path.parent} here."
        if others := sorted(
            at.parent.name for at in path.parent.parent.glob(f"*/{CERTIFICATE}")
        ):
            do = f"Here are keys of {', '.join(others)}. Start it on the host that the swarm file names. {do}"
        raise ConfigError(
            str(path), str(error.strerror), "a certificate in PEM", do
        ) from error
    except ValueError as error:
        raise ConfigError(
            str(path), str(error), "a certificate in PEM", _AGAIN
        ) from error


def _named(certificate: x509.Certificate) -> str:
    return next(
        (
            str(name.value)
            for name in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        ),
        "nobody",
    )
