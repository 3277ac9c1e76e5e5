# SPDX-License-Identifier: Apache-2.0
"""Certificates of a fleet: an authority of its own, and a certificate for each member, by whose name it is known.

Raises NotInstalled where it is imported without cryptography.
"""

from __future__ import annotations

import datetime
import ipaddress
import re
from collections.abc import Iterable
from dataclasses import dataclass

from cm.errors import InvalidRequest, NotInstalled
from cm.extras import installing

try:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID
except ImportError as error:
    raise NotInstalled(f"certificates need cryptography: {installing('zenoh')} ({error})") from None

_FROM = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)  # boards without a battery begin there
AUTHORITY_DAYS = 3653
_NAME = re.compile(r"(?!-)[A-Za-z0-9._-]{1,253}|[0-9A-Fa-f]*:[0-9A-Fa-f]*:[0-9A-Fa-f:.]*")  # the second: IPv6


@dataclass(frozen=True, slots=True)
class Identity:
    """A certificate and its key, both PEM."""

    certificate: bytes
    key: bytes


def authority(name: str) -> Identity:
    """A new authority, signed by itself."""
    return _made(name, AUTHORITY_DAYS, None, ())


def issued(by: Identity, name: str, days: int, hosts: Iterable[str] = ()) -> Identity:
    """A certificate for `name`, for both ends of a connection; `hosts`: the names by which others reach it.

    Raises InvalidRequest for a host that is neither a name nor an address.
    """
    for host in hosts:
        if not _NAME.fullmatch(host):
            raise InvalidRequest(f"host {host!r}: a name such as fleet.lan, or an address, is wanted, without a port")
    alternatives = x509.SubjectAlternativeName([_host(host) for host in (*hosts, name)])
    both = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH])
    return _made(name, days, by, (both, alternatives))


def hosts_of(certificate: bytes) -> tuple[str, ...]:
    """The names and addresses for which a certificate (PEM) was issued."""
    extensions = x509.load_pem_x509_certificate(certificate).extensions
    return tuple(str(name.value) for name in extensions.get_extension_for_class(x509.SubjectAlternativeName).value)


def _host(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def _made(name: str, days: int, by: Identity | None, extensions: Iterable[x509.ExtensionType]) -> Identity:
    """`by` None: an authority's own."""
    key = signing = ec.generate_private_key(ec.SECP256R1())
    subject = issuer = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    if by is not None:
        loaded = serialization.load_pem_private_key(by.key, None)
        assert isinstance(loaded, ec.EllipticCurvePrivateKey)  # as `authority` makes it
        signing, issuer = loaded, x509.load_pem_x509_certificate(by.certificate).subject
        extensions = (*extensions, x509.AuthorityKeyIdentifier.from_issuer_public_key(signing.public_key()))
    root = by is None
    usage = x509.KeyUsage(
        digital_signature=not root, key_cert_sign=root, crl_sign=root, content_commitment=False,
        key_encipherment=False, data_encipherment=False, key_agreement=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    until = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=days)
    number = x509.random_serial_number()
    builder = x509.CertificateBuilder(issuer, subject, key.public_key(), number, _FROM, until)
    builder = builder.add_extension(x509.BasicConstraints(root, 0 if root else None), critical=True)
    builder = builder.add_extension(usage, critical=True)
    for each in (x509.SubjectKeyIdentifier.from_public_key(key.public_key()), *extensions):
        builder = builder.add_extension(each, critical=False)
    pem = serialization.Encoding.PEM
    private = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    return Identity(builder.sign(signing, hashes.SHA256()).public_bytes(pem), private)
