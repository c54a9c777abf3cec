"""How tests reach a private Kubernetes: its API, and the certificates and keys that its services trust."""

from __future__ import annotations

import datetime
import ipaddress
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import urllib3
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import NameOID

Body = dict[str, Any]


class ApiRefusal(Exception):
    """An answer of the API server that is an error."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(f"{status}: {text}")
        self.status = status


class Api:
    """The API, with a token."""

    def __init__(self, url: str, authority: Path, token: str) -> None:
        self._url = url
        self._pool = urllib3.PoolManager(ca_certs=str(authority), retries=False, timeout=30)
        self._headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}

    def send(self, method: str, path: str, body: Body | None = None, content_type: str = "application/json") -> Body:
        """Send a request and return its answer. Raises ApiRefusal."""
        headers = {**self._headers, "Content-Type": content_type}
        data = None if body is None else json.dumps(body).encode()
        answer = self._pool.request(method, self._url + path, headers=headers, body=data)
        if answer.status >= 300:
            raise ApiRefusal(answer.status, answer.data.decode(errors="replace"))
        result: Body = json.loads(answer.data or b"{}")
        return result

    def find(self, path: str) -> Body | None:
        """Return an object; None where there is none."""
        try:
            return self.send("GET", path)
        except ApiRefusal as error:
            if error.status == 404:
                return None
            raise

    def items(self, path: str) -> list[Body]:
        """Return the objects of a list."""
        objects: list[Body] = self.send("GET", path)["items"]
        return objects

    def is_ready(self) -> bool:
        """Whether the API server answers, and has what it makes at its first start."""
        try:
            answer = self._pool.request("GET", f"{self._url}/readyz", headers=self._headers, timeout=2)
        except urllib3.exceptions.HTTPError:
            return False
        return answer.status == 200


def write_certificates(folder: Path, addresses: Sequence[str]) -> None:
    """Write an authority, certificates of the API server for its addresses and of its own requests, and a key."""
    now = datetime.datetime.now(datetime.timezone.utc)
    authority = rsa.generate_private_key(65537, 2048)
    issuer = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "kleinkram tests")])

    def write(name: str, subject: x509.Name, key: rsa.RSAPrivateKey, extension: x509.ExtensionType) -> None:
        made = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(issuer)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - datetime.timedelta(hours=1))
            .not_valid_after(now + datetime.timedelta(days=2))
            .add_extension(extension, critical=True)
            .sign(authority, hashes.SHA256())
        )
        (folder / f"{name}.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
        _write_key(folder / f"{name}.key", key)

    write("ca", issuer, authority, x509.BasicConstraints(ca=True, path_length=None))
    names = [x509.IPAddress(ipaddress.ip_address(address)) for address in addresses]
    server = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "kube-apiserver")])
    write("server", server, rsa.generate_private_key(65537, 2048), x509.SubjectAlternativeName(names))
    client = rsa.generate_private_key(65537, 2048)
    write("client", server, client, x509.ExtendedKeyUsage([x509.oid.ExtendedKeyUsageOID.CLIENT_AUTH]))
    accounts = rsa.generate_private_key(65537, 2048)
    _write_key(folder / "accounts.key", accounts)
    public = accounts.public_key().public_bytes(
        serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
    )
    (folder / "accounts.pub").write_bytes(public)


def _write_key(path: Path, key: rsa.RSAPrivateKey) -> None:
    path.touch(0o600)
    path.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.TraditionalOpenSSL, serialization.NoEncryption()
        )
    )
