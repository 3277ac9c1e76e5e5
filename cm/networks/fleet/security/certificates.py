# SPDX-License-Identifier: Apache-2.0
"""Certificates of a fleet: an authority of its own, and a certificate for each member, by whose name it is known."""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cm.errors import NotInstalled

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.x509 import CertificateBuilder, Name

_FROM = datetime.datetime(1970, 1, 1, tzinfo=datetime.timezone.utc)  # boards without a battery begin there
AUTHORITY_DAYS = 3653


@dataclass(frozen=True, slots=True)
class Identity:
    """A certificate and its key, both PEM."""

    certificate: bytes
    key: bytes


def _parts() -> Any:
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
    except ImportError as error:
        raise NotInstalled(f"certificates need cryptography: pip install 'fpga-cm[zenoh]' ({error})") from None
    return x509, hashes, serialization, ec


def authority(name: str) -> Identity:
    """A new authority, signed by itself."""
    x509, *_ = _parts()
    key = _new_key()
    subject = _named(name)
    builder = _builder(subject, subject, key.public_key(), AUTHORITY_DAYS)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_usage(sign_certificates=True), critical=True)
    builder = builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    return _signed(builder, key, key)


def issued(by: Identity, name: str, days: int, hosts: Iterable[str] = ()) -> Identity:
    """A certificate for `name`, for both ends of a connection; `hosts`: the names by which others reach it."""
    x509, _, serialization, _ = _parts()
    ca_key = serialization.load_pem_private_key(by.key, None)
    ca = x509.load_pem_x509_certificate(by.certificate)
    key = _new_key()
    builder = _builder(_named(name), ca.subject, key.public_key(), days)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(_usage(sign_certificates=False), critical=True)
    both = [x509.ExtendedKeyUsageOID.SERVER_AUTH, x509.ExtendedKeyUsageOID.CLIENT_AUTH]
    builder = builder.add_extension(x509.ExtendedKeyUsage(both), critical=False)
    by_whom = x509.AuthorityKeyIdentifier.from_issuer_public_key(ca_key.public_key())
    builder = builder.add_extension(by_whom, critical=False)
    builder = builder.add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    alternatives = x509.SubjectAlternativeName([_host(host) for host in (*hosts, name)])
    return _signed(builder.add_extension(alternatives, critical=False), key, ca_key)


def _new_key() -> EllipticCurvePrivateKey:
    *_, ec = _parts()
    key: EllipticCurvePrivateKey = ec.generate_private_key(ec.SECP256R1())
    return key


def _named(name: str) -> Name:
    x509, *_ = _parts()
    named: Name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    return named


def _host(text: str) -> Any:
    x509, *_ = _parts()
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        return x509.DNSName(text)


def _builder(subject: Name, issuer: Name, public: Any, days: int) -> CertificateBuilder:
    x509, *_ = _parts()
    now = datetime.datetime.now(datetime.timezone.utc)
    builder: CertificateBuilder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(_FROM)
        .not_valid_after(now + datetime.timedelta(days=days))
    )
    return builder


def _usage(sign_certificates: bool) -> Any:
    x509, *_ = _parts()
    return x509.KeyUsage(
        digital_signature=not sign_certificates,
        key_cert_sign=sign_certificates,
        crl_sign=sign_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _signed(builder: Any, key: Any, by: Any) -> Identity:
    _, hashes, serialization, _ = _parts()
    certificate = builder.sign(by, hashes.SHA256())
    pem = serialization.Encoding.PEM
    private = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    return Identity(certificate.public_bytes(pem), private)
