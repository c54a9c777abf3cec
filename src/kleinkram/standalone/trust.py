"""Whom this instance believes: with TLS, who has its own certificate."""

import ssl
from pathlib import Path


def just_this(certificate: Path) -> ssl.SSLContext:
    """Return a context that takes one certificate, whoever signed it and whatever name it is for."""
    context = ssl.create_default_context(cafile=str(certificate))
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    context.check_hostname = False
    return context


def bundle_with(certificate: Path) -> str:
    """Return the certificates that this machine believes, and one more, as PEM."""
    known = ssl.get_default_verify_paths().cafile
    usual = Path(known).read_text() if known and Path(known).is_file() else ""
    return usual + "\n" + certificate.read_text()
