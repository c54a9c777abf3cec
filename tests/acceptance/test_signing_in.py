"""Sign in to a real `klein up` from a terminal by browser, device code or token, and sign out."""

import json
import uuid
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from kleinkram.standalone.http_client import create_owner_link

from .browser import Browser, line_with, log_in
from .conftest import Instance, Terminal, end


def saved(terminal: Terminal) -> Any:
    return json.loads(endpoints_file(terminal).read_text())


def endpoints_file(terminal: Terminal) -> Path:
    return Path(terminal.environment["XDG_CONFIG_HOME"]) / "kleinkram" / "endpoints.json"


def test_login_by_browser_and_logout(away: Terminal, browser: Browser) -> None:
    login = log_in(away, browser, "--name", "lab")
    assert (login["name"], login["url"], login["person"]) == ("lab", browser.url, "owner")
    assert login["expires_at"] is not None
    assert endpoints_file(away).stat().st_mode & 0o777 == 0o600

    me = away.run("whoami", "--json").json()
    assert (me["person"]["name"], me["credential"]["kind"], me["endpoint"]) == ("owner", "personal", "lab")
    assert me["credential"]["name"].startswith("klein on ")
    (listed,) = away.run("endpoint", "list", "--json").json()["items"]
    assert (listed["name"], listed["person"], listed["in_use"], listed["expired"]) == ("lab", "owner", True, False)
    assert browser.status_of(saved(away)["endpoints"]["lab"]["token"]) == 200

    token = saved(away)["endpoints"]["lab"]["token"]
    assert "revoked" in away.run("logout").err
    assert saved(away) == {"version": 1, "current": None, "endpoints": {}}
    late = replace(away, environment={**away.environment, "KLEINKRAM_URL": browser.url, "KLEINKRAM_TOKEN": token})
    refused = late.run("whoami", code=4).err
    assert f"klein login {browser.url}" in refused
    assert "KLEINKRAM_TOKEN" in refused


def test_signing_in_again_revokes_the_previous_token(away: Terminal, browser: Browser) -> None:
    log_in(away, browser)
    before = saved(away)["endpoints"]
    log_in(away, browser)
    after = saved(away)["endpoints"]
    assert set(before) == set(after) == {urlsplit(browser.url).netloc}
    (old,), (new,) = before.values(), after.values()
    assert old["token"] != new["token"]
    assert [browser.status_of(endpoint["token"]) for endpoint in (old, new)] == [401, 200]


@pytest.mark.slow
def test_login_by_device_code_is_approved_or_denied_in_a_browser(away: Terminal, browser: Browser) -> None:
    environment = {**away.environment, "XDG_CONFIG_HOME": str(away.home / "refused")}
    other = replace(away, environment=environment)
    logins = [terminal.start("login", browser.url, "--device") for terminal in (away, other)]
    for process, decision in zip(logins, ("approve", "deny"), strict=True):
        browser.post(f"/auth/device/{decision}", {"user_code": line_with(process, "and type").split()[-1]})
    agreed, refused = (end(process) for process in logins)
    assert (agreed.code, refused.code) == (0, 4), (agreed, refused)
    assert "Signed in" in agreed.err
    (saved_endpoint,) = saved(away)["endpoints"].values()
    assert (saved_endpoint["person"], browser.status_of(saved_endpoint["token"])) == ("owner", 200)
    assert "denied" in refused.err
    assert not endpoints_file(other).exists()


def test_login_by_token(away: Terminal, browser: Browser) -> None:
    log_in(away, browser, "--name", "lab")
    token = saved(away)["endpoints"]["lab"]["token"]
    away.run("endpoint", "remove", "lab")

    wrong = away.run("login", browser.url, "--token", stdin="kk_wrong\n", code=4)
    assert "kk_wrong" not in wrong.err
    assert not saved(away)["endpoints"]
    assert "KLEINKRAM_TOKEN" in away.run("login", browser.url, "--token", code=2).err
    piped = away.run("login", browser.url, "--token", "--name", "piped", stdin=f"{token}\n")
    assert token not in piped.err + piped.out
    environment = {**away.environment, "KLEINKRAM_TOKEN": token}
    replace(away, environment=environment).run("login", browser.url, "--token", "--name", "named")
    assert {name: it["token"] for name, it in saved(away)["endpoints"].items()} == {"piped": token, "named": token}
    assert saved(away)["current"] == "named"

    ended = away.run("logout", "--all", "--json").json()["items"]
    assert [(item["name"], item["revoked"]) for item in ended] == [("piped", True), ("named", False)]
    assert saved(away)["endpoints"] == {}


def test_login_without_a_browser_suggests_a_device_code(away: Terminal, browser: Browser) -> None:
    hidden = {"BROWSER", "DISPLAY", "WAYLAND_DISPLAY"}
    bare = {name: value for name, value in away.environment.items() if name not in hidden}
    refused = replace(away, environment=bare).run("login", browser.url, code=2).err
    assert f"klein login {browser.url} --device" in refused


def test_a_file_that_others_can_read_is_refused(away: Terminal, browser: Browser) -> None:
    log_in(away, browser)
    endpoints_file(away).chmod(0o644)
    assert "chmod 600" in away.run("whoami", code=4).err
    endpoints_file(away).chmod(0o600)
    assert "owner" in away.run("whoami").out


@pytest.mark.slow
def test_logout_forgets_the_token_and_warns_when_the_server_is_unavailable(away: Terminal) -> None:
    away.run("endpoint", "add", "gone", "http://127.0.0.1:9", stdin="kk_secret\n")
    logout, login = away.start("logout"), away.start("login", "http://127.0.0.1:9")
    ended, refused = end(logout), end(login)
    assert (ended.code, refused.code) == (7, 7), (ended, refused)
    assert "could not be revoked" in ended.err
    assert "kk_secret" not in ended.err
    assert saved(away)["endpoints"] == {}
    assert "http://127.0.0.1:9" in refused.err
    assert "klein login" in away.run("whoami", code=2).err


def test_login_does_not_change_the_server_of_an_endpoint(away: Terminal, browser: Browser) -> None:
    away.run("endpoint", "add", "lab", "http://127.0.0.1:9", stdin="kk_secret\n")
    assert "http://127.0.0.1:9" in away.run("login", browser.url, "--name", "lab", code=5).err


def test_browsers_are_listed_and_signed_out(away: Terminal, browser: Browser) -> None:
    log_in(away, browser)
    first, *_ = sessions = away.run("session", "list", "--json").json()["items"]
    assert {session["is_current"] for session in sessions} == {False}
    away.run("session", "revoke", first["id"])
    away.run("session", "revoke", first["id"], code=3)
    away.run("session", "revoke", "--all", "--yes")
    assert away.run("session", "list", "--json").json()["items"] == []  # the token stays valid


def test_the_owner_of_this_machine_needs_no_sign_in(terminal: Terminal, instance: Instance) -> None:
    me = terminal.run("whoami", "--json").json()
    assert (me["person"]["name"], me["is_admin"], me["endpoint"]) == ("owner", True, "local")
    assert "klein down" in terminal.run("logout", code=2).err
    assert "klein session link" in terminal.run("login", code=2).err
    login = instance.runtime_info()
    token = Path(login["token_file"]).read_text().strip()
    shown = create_owner_link(login["local_url"], token)  # the link that `klein session link` prints
    assert shown is not None
    assert shown.startswith(f"{login['url']}/sign-in/link#")
    assert create_owner_link(login["local_url"], "another") is None


@pytest.mark.slow
def test_an_invited_person_gets_an_account_and_the_invited_rights(
    terminal: Terminal, away: Terminal, browser: Browser, project: str
) -> None:
    email = f"ben-{uuid.uuid4().hex[:8]}@partner.example"
    link = urlsplit(terminal.run("person", "invite", email, "--name", "Ben").out.strip())
    chosen = {"code": link.fragment, "password": uuid.uuid4().hex}
    ben = replace(browser, cookie=browser.sign_in("/auth/invitation", chosen))
    log_in(away, ben)
    assert away.run("whoami", "--json").json()["emails"] == [email]

    assert project in away.run("mission", "create", "walk", "-p", project, code=3).err
    terminal.run("access", "grant", "READ", "--to", email, "-p", project)
    away.run("mission", "list", "-p", project)
    assert "CREATE" in away.run("mission", "create", "walk", "-p", project, code=4).err

    def token() -> str:
        (saved_endpoint,) = saved(away)["endpoints"].values()
        return str(saved_endpoint["token"])

    again = urlsplit(terminal.run("person", "reset", email).out.strip())
    ben = replace(ben, cookie=ben.sign_in("/auth/reset", {**chosen, "code": again.fragment}))
    assert browser.status_of(token()) == 401, "a new password revokes tokens"
    log_in(away, ben)
    assert browser.status_of(token()) == 200
    terminal.run("person", "deactivate", email, "--yes")
    assert browser.status_of(token()) == 401
