"""Settings from the environment: misspelt names are errors, and secrets may come from files."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from kleinkram.server.environment import SettingsInvalid, known_variables, load_settings

_REPOSITORY = Path(__file__).parents[3]
_NEEDED = {
    "DATABASE_URL": "postgresql://serve@db/kleinkram",
    "S3_INTERNAL_URL": "http://store",
    "S3_ACCESS_KEY": "key",
    "S3_SECRET_KEY": "hunter22",
}


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in _NEEDED.items():
        monkeypatch.setenv(f"KLEINKRAM_{name}", value)


def _refusal() -> str:
    with pytest.raises(SettingsInvalid) as raised:
        load_settings()
    return str(raised.value)


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("TRUSTED_PROXY", "TRUSTED_PROXIES"), ("TRASHDAYS", "TRASH_DAYS"), ("S3_SECRET", "S3_SECRET_KEY")],
)
def test_a_misspelt_setting_is_reported_with_a_suggestion(
    monkeypatch: pytest.MonkeyPatch, wrong: str, right: str
) -> None:
    monkeypatch.setenv(f"KLEINKRAM_{wrong}", "1")
    assert f"KLEINKRAM_{wrong} is not a setting: did you mean KLEINKRAM_{right}?" in _refusal()


def test_variables_of_other_programs_and_orchestrators_are_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {
        "TOKEN": "klein_x",
        "DATA_DIR": "/data",
        "TEST_INSTALL": "1",
        "BACKUP_PASSPHRASE": "x",
        "API_SERVICE_HOST": "10.0.0.1",
        "API_PORT": "tcp://10.0.0.1:8000",
        "API_PORT_8000_TCP_ADDR": "10.0.0.1",
        "API_SERVICE_PORT_HTTP": "8000",
    }.items():
        monkeypatch.setenv(f"KLEINKRAM_{name}", value)
    assert load_settings().s3_bucket == "kleinkram"


def test_every_variable_that_any_of_our_programs_reads_is_known() -> None:
    named: set[str] = set()
    for folder in ("src/kleinkram", "examples"):
        for path in (_REPOSITORY / folder).rglob("*.py"):
            named |= set(re.findall(r'"(KLEINKRAM_[A-Z0-9_]*[A-Z0-9])["=]', path.read_text(encoding="utf-8")))
    assert len(named) > 10
    of_tests = {"KLEINKRAM_REQUIRE_ALL"}  # the story obeys it, and servers accept it in their environment
    assert named - of_tests - set(known_variables()) == set()


def test_all_invalid_settings_are_reported_at_once_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("KLEINKRAM_DATABASE_URL")
    monkeypatch.setenv("KLEINKRAM_TRASH_DAYS", "-1")
    monkeypatch.setenv("KLEINKRAM_TRASHDAYS", "1")
    lines = _refusal().splitlines()
    assert any(line.startswith("KLEINKRAM_DATABASE_URL is not set: PostgreSQL") for line in lines)
    assert any(line.startswith("KLEINKRAM_TRASH_DAYS: ") for line in lines)
    assert any(line.startswith("KLEINKRAM_TRASHDAYS is not") for line in lines)
    assert len(lines) == 3
    monkeypatch.setenv("KLEINKRAM_VIEWERS", "Lichtblick")
    assert "KLEINKRAM_VIEWERS does not hold JSON." in _refusal()


@pytest.mark.parametrize("command", ["migrate", "api", "worker"])
def test_missing_settings_are_reported_as_a_sentence(command: str) -> None:
    ran = subprocess.run(
        [sys.executable, "-m", "kleinkram.server", command], env={}, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 1
    assert "KLEINKRAM_DATABASE_URL is not set" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_secrets_come_from_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("p@ss:w/d\n")
    monkeypatch.delenv("KLEINKRAM_S3_SECRET_KEY")
    monkeypatch.setenv("KLEINKRAM_S3_SECRET_KEY_FILE", str(secret))
    monkeypatch.setenv("KLEINKRAM_DATABASE_PASSWORD_FILE", str(secret))
    providers = tmp_path / "providers"
    providers.write_text('[{"name": "lab", "title": "Lab", "issuer": "https://id.example", "client_id": "k"}]')
    monkeypatch.setenv("KLEINKRAM_OIDC_PROVIDERS_FILE", str(providers))
    settings = load_settings()
    assert settings.s3_secret_key.get_secret_value() == "p@ss:w/d"
    assert str(settings.database_url) == "postgresql://serve:p%40ss%3Aw%2Fd@db/kleinkram"
    assert settings.oidc_providers[0].name == "lab"


def test_a_secret_has_one_source_and_its_file_must_exist(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.touch()
    monkeypatch.setenv("KLEINKRAM_S3_SECRET_KEY_FILE", str(empty))
    assert "KLEINKRAM_S3_SECRET_KEY and KLEINKRAM_S3_SECRET_KEY_FILE are both set" in _refusal()
    monkeypatch.delenv("KLEINKRAM_S3_SECRET_KEY")
    assert _refusal() == f"KLEINKRAM_S3_SECRET_KEY_FILE: {empty} is empty."
    monkeypatch.setenv("KLEINKRAM_S3_SECRET_KEY_FILE", str(tmp_path / "nowhere"))
    assert "cannot be read (No such file or directory)" in _refusal()
    monkeypatch.setenv("KLEINKRAM_TRASH_DAYS_FILE", str(empty))
    assert "KLEINKRAM_TRASH_DAYS_FILE is not a setting" in _refusal(), "only secrets come from files"


def test_a_secret_set_instead_of_its_file_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("KLEINKRAM_S3_SECRET_KEY")
    monkeypatch.setenv("KLEINKRAM_S3_SECRET_KEY_FILE", "hunter22")
    assert "KLEINKRAM_S3_SECRET_KEY_FILE: what it names (not an absolute path) cannot be read" in _refusal()
    assert "hunter22" not in _refusal()


def test_variables_of_secret_files_ignore_case(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("of a file")
    monkeypatch.setenv("kleinkram_s3_secret_key_file", str(secret))
    assert "are both set" in _refusal()
    monkeypatch.delenv("KLEINKRAM_S3_SECRET_KEY")
    assert load_settings().s3_secret_key.get_secret_value() == "of a file"


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"REPORT_TO": "ada@lab.example"}, "KLEINKRAM_REPORT_TO needs KLEINKRAM_SMTP_HOST and KLEINKRAM_MAIL_FROM"),
        ({"SMTP_USER": "ada"}, "KLEINKRAM_SMTP_USER and KLEINKRAM_SMTP_PASSWORD belong together"),
        ({"SMTP_USER": "ada", "SMTP_PASSWORD": "hunter22", "SMTP_SECURITY": "none"}, "is not sent without encryption"),
        ({"REPORT_TO": "Ada <ada@lab.example>"}, "KLEINKRAM_REPORT_TO (0): is not an address such as"),
        ({"SMTP_SECURITY": "ssl"}, "KLEINKRAM_SMTP_SECURITY: "),
    ],
)
def test_incomplete_mail_settings_are_refused(
    monkeypatch: pytest.MonkeyPatch, values: dict[str, str], sentence: str
) -> None:
    for name, value in values.items():
        monkeypatch.setenv(f"KLEINKRAM_{name}", value)
    refusal = _refusal()
    assert sentence in refusal
    assert "hunter22" not in refusal


def test_the_password_of_the_mail_server_may_come_from_a_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "password").write_text("hunter22\n")
    values = {"SMTP_HOST": "mail", "SMTP_USER": "ada", "MAIL_FROM": "k@lab.example", "REPORT_TO": "a@x.org, b@x.org"}
    for name, value in {**values, "SMTP_PASSWORD_FILE": str(tmp_path / "password")}.items():
        monkeypatch.setenv(f"KLEINKRAM_{name}", value)
    settings = load_settings()
    assert settings.smtp_password is not None
    assert settings.smtp_password.get_secret_value() == "hunter22"
    assert settings.report_to == ("a@x.org", "b@x.org")
