"""The second factor of local accounts: enrolment, use, one-time codes, reset."""

import time
from typing import Any

import pyotp
import pytest

from tests.integration import people
from tests.integration.api_server import Api
from tests.integration.auth.accounts import PASSWORD, Account, account, code_of, sign_in
from tests.integration.auth.browser import Browser


class Device:
    """An authenticator app whose clock the test moves, so that no test waits for the next code."""

    def __init__(self, api: Api, secret: str, person_id: str) -> None:
        self._api, self._totp, self._person_id = api, pyotp.TOTP(secret), person_id

    def code(self) -> str:
        """Return the code of now."""
        return self._totp.at(int(time.time()))

    def next_code(self) -> str:
        """Return a code that was not used yet: the one of now, once the server has forgotten that it took it."""
        self._api.sql("UPDATE totp SET last_step = 0 WHERE person_id = %s", self._person_id)
        return self.code()


def _enrol(api: Api, who: Account) -> tuple[Device, list[str]]:
    begun = who.browser.post("/me/totp").ok(201)
    device = Device(api, begun["secret"], who.id)
    assert pyotp.parse_uri(begun["url"]).secret == begun["secret"]
    assert begun["qr"].startswith("data:image/svg+xml")
    return device, who.browser.post("/me/totp/confirm", {"code": device.code()}).ok()["codes"]


@pytest.fixture(name="ada")
def _ada(api: Api) -> Account:
    return account(api)


def _enrolled(who: Account, **more: Any) -> dict[str, Any]:
    return {"email": who.email, "password": PASSWORD, **more}


def test_signing_in_requires_password_and_code(api: Api, ada: Account) -> None:
    other = Browser(api)
    sign_in(other, ada.email)
    device, codes = _enrol(api, ada)
    assert not other.is_signed_in(), "a browser that was signed in without a code"
    assert len(set(codes)) == 10
    browser = Browser(api)
    browser.post("/auth/password", _enrolled(ada)).refused(401, "second_factor_needed")
    browser.post("/auth/password", _enrolled(ada, second_factor="000000")).refused(401, "second_factor_wrong")
    wrong = _enrolled(ada, second_factor=device.next_code()) | {"password": "another password"}
    browser.post("/auth/password", wrong).refused(401, "sign_in_failed")
    assert not browser.is_signed_in()
    browser.post("/auth/password", _enrolled(ada, second_factor=device.next_code())).ok()
    assert browser.is_signed_in()


def test_a_code_is_valid_once(api: Api, ada: Account) -> None:
    device, _ = _enrol(api, ada)
    enrolled_with = device.code()
    Browser(api).post("/auth/password", _enrolled(ada, second_factor=enrolled_with)).refused(401, "second_factor_wrong")
    code = device.next_code()
    Browser(api).post("/auth/password", _enrolled(ada, second_factor=code)).ok()
    Browser(api).post("/auth/password", _enrolled(ada, second_factor=code)).refused(401, "second_factor_wrong")


def test_a_recovery_code_is_valid_once(api: Api, ada: Account) -> None:
    _, codes = _enrol(api, ada)
    browser = Browser(api)
    browser.post("/auth/password", _enrolled(ada, second_factor=codes[0].lower())).ok()
    again = Browser(api).post("/auth/password", _enrolled(ada, second_factor=codes[0]))
    again.refused(401, "second_factor_wrong")
    assert browser.get("/api/v1/me/account").ok()["totp"]["recovery_codes_left"] == 9
    renewed = browser.post("/me/totp/recovery-codes").ok()["codes"]
    assert not set(renewed) & set(codes)
    Browser(api).post("/auth/password", _enrolled(ada, second_factor=codes[1])).refused(401, "second_factor_wrong")
    operations = [event["operation"] for event in api.events(ada.id)]
    assert {"totp.enable", "totp.use_recovery_code", "totp.renew_codes"} <= set(operations)


def test_ten_wrong_codes_cause_a_lockout(api: Api, ada: Account) -> None:
    device, _ = _enrol(api, ada)
    for _ in range(10):
        Browser(api).post("/auth/password", _enrolled(ada, second_factor="not it")).refused(401, "second_factor_wrong")
    right = _enrolled(ada, second_factor=device.next_code())
    Browser(api).post("/auth/password", right).refused(401, "second_factor_wrong")
    api.sql("UPDATE totp SET failed_at = now() - interval '16 minutes' WHERE person_id = %s", ada.id)
    Browser(api).post("/auth/password", right).ok()


def test_the_second_factor_is_required_only_after_confirmation(api: Api, ada: Account) -> None:
    ada.browser.post("/me/totp").ok(201)
    ada.browser.post("/me/totp/confirm", {"code": "000000"}).refused(401, "second_factor_wrong")
    sign_in(Browser(api), ada.email)
    assert ada.browser.get("/api/v1/me/account").ok()["totp"] is None


def test_a_password_reset_requires_the_code_too(api: Api, ada: Account) -> None:
    device, _ = _enrol(api, ada)
    code = code_of(api.post(f"/people/{ada.id}/reset").ok(201)["url"])
    new = {"code": code, "password": "another good password"}
    Browser(api).post("/auth/reset", new).refused(401, "second_factor_needed")
    Browser(api).post("/auth/reset", new | {"second_factor": device.next_code()}).ok()


def test_an_admin_resets_the_second_factor_of_a_lost_device(api: Api, ada: Account) -> None:
    _enrol(api, ada)
    api.as_(people.person(api).token).delete(f"/people/{ada.id}/totp").refused(403, "forbidden")
    api.delete(f"/people/{ada.id}/totp").ok(204)
    sign_in(Browser(api), ada.email)
    assert "totp.reset" in [event["operation"] for event in api.events(ada.id)]
    api.delete(f"/people/{ada.id}/totp").refused(404, "not_found")


def test_a_person_disables_their_second_factor(api: Api, ada: Account) -> None:
    _enrol(api, ada)
    ada.browser.post("/me/totp").refused(409, "name_taken")
    ada.browser.call("DELETE", "/api/v1/me/totp").ok(204)
    sign_in(Browser(api), ada.email)
    assert "totp.disable" in [event["operation"] for event in api.events(ada.id)]


def test_the_secret_of_the_second_factor_is_shown_once(api: Api, ada: Account) -> None:
    begun = ada.browser.post("/me/totp").ok(201)
    ada.browser.post("/me/totp/confirm", {"code": pyotp.TOTP(begun["secret"]).now()}).ok()
    message = [ada.browser.get(path).body for path in ("/api/v1/me/account", "/api/v1/me")]
    message += [api.events(ada.id), api.get("/audit").body]
    assert begun["secret"] not in str(message)


def test_an_account_without_a_password_has_no_second_factor(api: Api) -> None:
    from tests.integration.auth.accounts import signed_in

    signed_in(api).browser.post("/me/totp").refused(403, "forbidden")
