# SPDX-License-Identifier: Apache-2.0
"""Certificates of a fleet: an authority of its own, and a certificate for each member, by whose name it is known.

Raises NotInstalled where it is imported without cryptography.
"""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Iterable
from dataclasses import dataclass

from cm.errors import NotInstalled

try:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID
except ImportError as error:
    raise NotInstalled(f"certificates need cryptography: pip install 'fpga-cm[zenoh]' ({error})") from None

_FROM = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)  # boards without a battery begin there
AUTHORITY_DAYS = 3653


@dataclass(frozen=True, slots=True)
class Identity:
    """A certificate and its key, both PEM."""

    certificate: bytes
    key: bytes


def authority(name: str) -> Identity:
    """A new authority, signed by itself."""
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(name, _named(name), key, AUTHORITY_DAYS, is_authority=True)
    return _signed(builder, key, key)


def issued(by: Identity, name: str, days: int, hosts: Iterable[str] = ()) -> Identity:
    """A certificate for `name`, for both ends of a connection; `hosts`: the names by which others reach it."""
    ca_key = serialization.load_pem_private_key(by.key, None)
    assert isinstance(ca_key, ec.EllipticCurvePrivateKey)  # as `authority` makes it
    key = ec.generate_private_key(ec.SECP256R1())
    both = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    builder = _builder(name, x509.load_pem_x509_certificate(by.certificate).subject, key, days, is_authority=False)
    builder = builder.add_extension(x509.ExtendedKeyUsage(both), critical=False)
    by_whom = x509.AuthorityKeyIdentifier.from_issuer_public_key(ca_key.public_key())
    builder = builder.add_extension(by_whom, critical=False)
    alternatives = x509.SubjectAlternativeName([_host(host) for host in (*hosts, name)])
    return _signed(builder.add_extension(alternatives, critical=False), key, ca_key)


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])


def _host(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def _builder(
    name: str, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: int, is_authority: bool
) -> x509.CertificateBuilder:
    usage = x509.KeyUsage(
        digital_signature=not is_authority, key_cert_sign=is_authority, crl_sign=is_authority,
        content_commitment=False, key_encipherment=False, data_encipherment=False, key_agreement=False,
        encipher_only=False, decipher_only=False,
    )  # fmt: skip
    until = datetime.datetime.now(datetime.timezone.utc) + datetime.timedelta(days=days)
    return (
        x509.CertificateBuilder(issuer, _named(name), key.public_key(), x509.random_serial_number(), _FROM, until)
        .add_extension(x509.BasicConstraints(is_authority, 0 if is_authority else None), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _signed(
    builder: x509.CertificateBuilder, key: ec.EllipticCurvePrivateKey, by: ec.EllipticCurvePrivateKey
) -> Identity:
    pem = serialization.Encoding.PEM
    private = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    return Identity(builder.sign(by, hashes.SHA256()).public_bytes(pem), private)
