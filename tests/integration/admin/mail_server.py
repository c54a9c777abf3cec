"""A mail server on this machine that keeps what it receives; with TLS, STARTTLS and a password, as real ones have."""

import base64
import contextlib
import email
import email.policy
import socketserver
import ssl
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from email.message import EmailMessage
from pathlib import Path
from typing import IO

from kleinkram.server.settings import SmtpSecurity
from tests.certificate import make_certificate

USER, PASSWORD = "kleinkram", "hunter22"


@dataclass
class MailServer:
    """What it received, and how it is reached. `refused`: recipients whose address has this in it; None for none."""

    security: SmtpSecurity
    tls: ssl.SSLContext
    ca_file: Path
    port: int = 0
    refused: str | None = None
    messages: list[EmailMessage] = field(default_factory=list)

    def settings(self) -> dict[str, object]:
        """The settings that use it."""
        values: dict[str, object] = {"smtp_host": "127.0.0.1", "smtp_port": self.port, "smtp_security": self.security}
        if self.security is SmtpSecurity.none:
            return values
        return {**values, "smtp_user": USER, "smtp_password": PASSWORD, "smtp_ca_file": self.ca_file}


@contextlib.contextmanager
def mail_server(folder: Path, security: SmtpSecurity) -> Iterator[MailServer]:
    """Run one in a thread."""
    certificate, key = make_certificate(folder, "127.0.0.1")
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    tls.load_cert_chain(certificate, key)
    state = MailServer(security, tls, certificate)

    class Handler(_Handler):
        server_state = state

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        state.port = server.server_address[1]
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        try:
            yield state
        finally:
            server.shutdown()
            thread.join()


class _Handler(socketserver.BaseRequestHandler):
    """One connection. Source: RFC 5321, and RFC 3207 and 4954 for STARTTLS and AUTH PLAIN."""

    server_state: MailServer

    def handle(self) -> None:
        state = self.server_state
        self._is_signed_in = state.security is SmtpSecurity.none
        with contextlib.suppress(OSError):  # a client that does not trust the certificate leaves
            if state.security is SmtpSecurity.tls:
                self._encrypt()
            self._open()
            self._say("220 ready")
            while line := self._stream.readline().decode().rstrip("\r\n"):
                verb, _, rest = line.partition(" ")
                if verb.upper() == "QUIT":
                    self._say("221 bye")
                    break
                self._answer(verb.upper(), rest)
            self._stream.close()
        self.request.close()

    def _open(self) -> None:
        self._stream: IO[bytes] = self.request.makefile("rb")

    def _encrypt(self) -> None:
        self.request = self.server_state.tls.wrap_socket(self.request, server_side=True)

    def _say(self, text: str) -> None:
        self.request.sendall(f"{text}\r\n".encode())

    def _answer(self, verb: str, rest: str) -> None:
        state = self.server_state
        if verb == "EHLO":
            self._say("250-here\r\n250-STARTTLS\r\n250 AUTH PLAIN")
        elif verb == "STARTTLS":
            self._say("220 go")
            self._encrypt()
            self._open()
        elif verb == "AUTH":
            expected = base64.b64encode(f"\0{USER}\0{PASSWORD}".encode()).decode()
            self._is_signed_in = rest == f"PLAIN {expected}" and isinstance(self.request, ssl.SSLSocket)
            self._say("235 welcome" if self._is_signed_in else "535 wrong password")
        elif not self._is_signed_in:
            self._say("530 sign in first")
        elif verb == "RCPT" and state.refused is not None and state.refused in rest:
            self._say("550 no such mailbox")
        elif verb == "DATA":
            self._say("354 go")
            lines = iter(self._stream.readline, b".\r\n")
            raw = b"".join(line.removeprefix(b".") for line in lines)
            state.messages.append(email.message_from_bytes(raw, policy=email.policy.default))
            self._say("250 kept")
        else:
            self._say("250 fine")
