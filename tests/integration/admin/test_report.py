"""The weekly mail, received by a real mail server on this machine."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from kleinkram.server.admin.report import send_due_report
from kleinkram.server.health.checks import _mail
from kleinkram.server.mail import MailNotSent
from kleinkram.server.settings import Settings, SmtpSecurity
from tests.integration.admin.mail_server import PASSWORD, MailServer, mail_server
from tests.integration.api_server import Api
from tests.integration.conftest import StartApi
from tests.integration.jobs import on_site

_TO = ("ada@lab.example", "grace@lab.example")


@pytest.fixture(name="inbox", params=[*SmtpSecurity])
def _inbox(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[MailServer]:
    with mail_server(tmp_path, request.param) as server:
        yield server


def _start(start_api: StartApi, inbox: MailServer, **more: object) -> Api:
    return start_api(**{**inbox.settings(), "report_to": _TO, "mail_from": "kleinkram@lab.example", **more})


def test_each_recipient_gets_the_status_once_a_week(start_api: StartApi, inbox: MailServer) -> None:
    api = _start(start_api, inbox, lab_name="Robots\nBcc: eve@evil.example")
    assert on_site(api, send_due_report)
    assert not on_site(api, send_due_report), "this week's was sent"
    assert [message["To"] for message in inbox.messages] == [*_TO]
    for message in inbox.messages:
        assert message["From"] == "kleinkram@lab.example"
        assert (message["Bcc"], message["Auto-Submitted"]) == (None, "auto-generated")
        assert message["Subject"].startswith("Robots Bcc: eve@evil.example: problems: 1")
        assert "PROBLEM workers: No worker process has ever run" in message.get_content()
    (event,) = api.all("/audit", {"operation": "report.send"})
    assert (event["actor"], event["after"]["recipients"]) == (None, 2)
    api.sql("UPDATE audit_event SET at = at - interval '7 days' WHERE operation = 'report.send'")
    assert on_site(api, send_due_report)
    assert len(inbox.messages) == 4


def test_a_report_that_is_not_accepted_is_sent_later(start_api: StartApi, inbox: MailServer) -> None:
    api = _start(start_api, inbox)
    inbox.refused = "@"
    with pytest.raises(MailNotSent, match="no such mailbox"):
        on_site(api, send_due_report)
    assert api.all("/audit", {"operation": "report.send"}) == []
    inbox.refused = None
    assert on_site(api, send_due_report)


def test_an_address_that_is_refused_does_not_make_others_get_the_report_again(
    start_api: StartApi, inbox: MailServer
) -> None:
    api = _start(start_api, inbox)
    inbox.refused = _TO[0]
    assert on_site(api, send_due_report)
    assert not on_site(api, send_due_report)
    assert [message["To"] for message in inbox.messages] == [_TO[1]]


def test_check_signs_in_and_names_what_is_wrong(inbox: MailServer) -> None:
    base = {"database_url": "postgresql://u@h/d", "s3_internal_url": "http://s", "s3_access_key": "k"}
    settings = Settings(**{**base, "s3_secret_key": "s", **inbox.settings()})  # type: ignore[arg-type]  # validated
    assert [result.severity.value for result in _mail(settings)] == ["ok"]
    assert inbox.messages == []
    if settings.smtp_user is not None:
        foreign = Settings(**{**base, "s3_secret_key": "s", **inbox.settings(), "smtp_password": "pässword"})  # type: ignore[arg-type]
        assert ["must be ASCII" in result.message for result in _mail(foreign)] == [True]
        wrong = Settings(**{**base, "s3_secret_key": "s", **inbox.settings(), "smtp_password": "no"})  # type: ignore[arg-type]
        (result,) = _mail(wrong)
        assert (result.severity.value, "refused the user or password (535)" in result.message) == ("problem", True)
        untrusted = settings.model_copy(update={"smtp_ca_file": None})
        (result,) = _mail(untrusted)
        assert (result.severity.value, "certificate" in result.message) == ("problem", True)
        assert PASSWORD not in result.message


def test_without_recipients_nothing_is_sent(start_api: StartApi) -> None:
    assert not on_site(start_api(), send_due_report)
