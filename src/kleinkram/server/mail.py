"""Mail from the server through the mail server of the settings. Blocks: call it in a thread.

A failed attempt is the caller's to repeat; nothing is queued here.
"""

import contextlib
import logging
import smtplib
import ssl
from collections.abc import Iterator
from email.message import EmailMessage
from email.utils import formatdate, make_msgid

from kleinkram.server.settings import Settings, SmtpSecurity

_log = logging.getLogger("kleinkram.mail")
_TIMEOUT_S = 30.0


class MailNotSent(Exception):
    """The mail server does not answer, or refused. The text says which, without the password."""


def send_mail(settings: Settings, *, subject: str, text: str) -> None:
    """Send a text to all addresses of `report_to`, in one message for each.

    An address that the mail server refuses does not keep the others from their messages: a repetition would send these
    again.

    Raises:
        MailNotSent: the mail server failed, or refused all addresses.
    """
    refusals: list[smtplib.SMTPRecipientsRefused] = []
    with open_mail_server(settings) as server:
        for address in settings.report_to:
            message = EmailMessage()
            message["From"], message["To"] = settings.mail_from, address
            message["Subject"] = " ".join(subject.split())
            message["Date"], message["Message-ID"] = (
                formatdate(),
                make_msgid(domain=str(settings.mail_from).partition("@")[2]),
            )
            # So that no automatic reply comes back. Source: RFC 3834, section 5.
            message["Auto-Submitted"] = "auto-generated"
            message.set_content(text)
            try:
                server.send_message(message)
            except smtplib.SMTPRecipientsRefused as error:
                _log.warning("the mail server refused an address", extra={"fields": {"reason": str(error)}})
                refusals.append(error)
        if len(refusals) == len(settings.report_to):
            raise refusals[0]


@contextlib.contextmanager
def open_mail_server(settings: Settings) -> Iterator[smtplib.SMTP]:
    """Connect to the mail server, encrypted as set, and sign in. Raises MailNotSent, also within the block."""
    host, port = str(settings.smtp_host), settings.smtp_port
    try:
        with _connect(settings, host, port) as server:
            if settings.smtp_security is SmtpSecurity.starttls:
                server.starttls(context=_tls(settings))
            if settings.smtp_user is not None and settings.smtp_password is not None:
                server.login(settings.smtp_user, settings.smtp_password.get_secret_value())
            yield server
    except smtplib.SMTPAuthenticationError as error:
        raise MailNotSent(f"The mail server {host} refused the user or password ({error.smtp_code}).") from None
    except UnicodeEncodeError:  # of `login`, which sends ASCII only
        raise MailNotSent(f"The user and the password for {host} must be ASCII.") from None
    except (smtplib.SMTPException, OSError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise MailNotSent(f"The mail server {host}:{port} failed: {reason}.") from None


def _connect(settings: Settings, host: str, port: int) -> smtplib.SMTP:
    if settings.smtp_security is SmtpSecurity.tls:
        return smtplib.SMTP_SSL(host, port, timeout=_TIMEOUT_S, context=_tls(settings))
    return smtplib.SMTP(host, port, timeout=_TIMEOUT_S)


def _tls(settings: Settings) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=settings.smtp_ca_file)
