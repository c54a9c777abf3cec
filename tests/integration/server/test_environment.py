"""Settings from the environment: misspelt names are errors, and secrets may come from files."""

import enum
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic.fields import FieldInfo

from kleinkram.server.environment import SettingsInvalid, known_variables, load_settings
from kleinkram.server.health import checks
from kleinkram.server.settings import Settings, is_secret

_REPOSITORY = Path(__file__).parents[3]
_NEEDED = {
    "DATABASE_URL": "postgresql://serve@db/kleinkram",
    "S3_INTERNAL_URL": "http://store",
    "S3_ACCESS_KEY": "key",
    "S3_SECRET_KEY": "hunter22",
}

_NO_ADDRESS = "must be an address such as"
_NO_LIST = "it must be a list"
_NO_JSON = "does not hold JSON"
_PROVIDER = '[{"name": "lab", "title": "Lab", "issuer": "https://id.example", "client_id": "k", %s}]'
_WRONG_URLS = tuple(
    (url, _NO_ADDRESS)
    for url in ("host:9000", "ftp://host", "https://", "http://host:99999", "http://me:hunter22@host", "http://a/?b=c")
)
_WRONG_DSNS = tuple(
    (url, _NO_ADDRESS)
    for url in (
        *("db", "mysql://me@db/kleinkram", "postgresql://me@db:port/kleinkram", "postgresql://me:hunter22#x@db/k"),
        *("postgresql://me:hunter22%zz@db/kleinkram", "postgresql://me:hunter22@db/kleinkram?mode=x"),
    )
)
_WRONG_CERTIFICATES = (("/nowhere/ca", "No such file"), ("/etc/passwd", "no certificates"), ("/", "Is a directory"))
_WRONG_NETWORKS = (("10.0.0.1/8", "has host bits set"), ("proxy", "such as 10.0.0.0/8"), ("10.0.0.0/8;::1", "such as"))
_TILES = "must be an address such as https://host/{z}/{x}/{y}.png"
_WRONG_TILES = (
    ("https://tiles.example/{z}/{x}.png", _TILES),
    ("https://tiles.example/{z}/{x}/{y}/{y}.png", _TILES),
    ("https://{s}.tiles.example/{z}/{x}/{y}.png", _TILES),
    ("https://tiles.example;script-src/{z}/{x}/{y}.png", _TILES),
    ("https://a:b@tiles.example/{z}/{x}/{y}.png", _TILES),
    ("ftp://tiles.example/{z}/{x}/{y}.png", _TILES),
    ("https://tiles.example:0/{z}/{x}/{y}.png", _TILES),
    ("/{z}/{x}/{y}.png", _TILES),
    ("https://tiles.example/{z}/{x}/{y}.png", "needs KLEINKRAM_MAP_TILES_ATTRIBUTION"),
)
# What is wrong for the settings that are no numbers and no choices, and the words that say so.
_WRONG: dict[str, tuple[tuple[str, str], ...]] = {
    "affiliations": (
        ("Lab", _NO_JSON),
        ('{"name": "Lab"}', _NO_LIST),
        ('[{"name": "Lab", "domains": []}]', "(0.domains): there are fewer than 1"),
        ('[{"name": "Lab", "domains": ["@lab.example"]}]', "(0.domains.0): "),
        ('[{"name": "Lab", "domain": ["lab.example"]}]', "(0.domain): there is no such field"),
    ),
    "audit_days": (("7", "must be 0, or at least 30"),),
    "database_password": (("hunter22", "needs a database URL with a user and no password"),),
    "database_url": _WRONG_DSNS,
    "lab_name": (("x" * 65, "more than 64 characters"),),
    "map_tiles_attribution": (("x" * 201, "more than 200 characters"),),
    "map_tiles_url": _WRONG_TILES,
    "mail_from": (("kleinkram", "is not an address such as"),),
    "metrics_address": (("http://127.0.0.1", "it must match"),),
    "migration_database_password": (("hunter22", "needs a database URL with a user and no password"),),
    "migration_database_url": _WRONG_DSNS,
    "monitoring_networks": _WRONG_NETWORKS,
    "oidc_providers": (
        ("{hunter22", _NO_JSON),
        ("{}", _NO_LIST),
        ("[{}]", "(0.name): it is required"),
        (_PROVIDER % '"scopes": "openid"', f"(0.scopes): {_NO_LIST}"),
        (_PROVIDER % '"client_secret": ""', "(0.client_secret): is empty"),
        (_PROVIDER % '"client_secret_file": "/nowhere"', "/nowhere cannot be read (No such file"),
        (_PROVIDER % '"client_secret_file": "hunter22"', "(not an absolute path) cannot be read"),
        (_PROVIDER % '"issuer": "http://id.example"', "(0.issuer): must be an https address"),
    ),
    "owner_token_file": (("/nowhere/token", "No such file"), ("/", "Is a directory")),
    "package_index": (("hunter22", "must be 'pypi'"), ("ftp://me:hunter22@index", "must be 'pypi'")),
    "public_url": _WRONG_URLS,
    "report_to": (("ada", "(0): is not an address such as"), ("ada@lab.example", "needs KLEINKRAM_SMTP_HOST")),
    "s3_access_key": (("hunter 22", "it must match"),),
    "s3_bucket": (("ab", "it must match"), ('"kleinkram"', "it must match"), ("a/b/c", "it must match")),
    "s3_ca_file": _WRONG_CERTIFICATES,
    "s3_internal_url": _WRONG_URLS,
    "s3_public_url": _WRONG_URLS,
    "s3_region": (("eu central", "it must match"),),
    "s3_secret_key": (("hunter22 ", "white space"),),
    "serving_role": (("kleinkram-serve", "it must match"), ("x; DROP TABLE run", "it must match")),
    "smtp_ca_file": _WRONG_CERTIFICATES,
    "smtp_host": (("smtp://mail", "it must match"),),
    "smtp_password": (("hunter22", "belong together"),),
    "smtp_user": (("ada", "belong together"),),
    "store_id": (("x" * 65, "it must match"),),
    "trusted_proxies": _WRONG_NETWORKS,
    "viewers": (
        ("Lichtblick", _NO_JSON),
        ('"Lichtblick"', _NO_LIST),
        ('[{"name": "Lichtblick", "url": "https://viewer.example"}]', "(0.url): it must match"),
        ('[{"name": "Lichtblick"}]', "(0.url): it is required"),
    ),
}
# What only `check` notices, since a server works without it, or since it changes while a server runs.
_WRONG_ON_THIS_MACHINE = {
    "audit_archive": ("/nowhere", "/nowhere."),
    "metrics_address": ("192.0.2.1", "This machine has no address 192.0.2.1"),
    "store_folder": ("/nowhere", "/nowhere is no folder"),
}


def _type(field: FieldInfo) -> type:
    return field.annotation if isinstance(field.annotation, type) else object


def _wrong_values(name: str, field: FieldInfo) -> Iterator[tuple[str, str]]:
    """Yield the wrong values that follow from the declaration, and those of the table, with words of the refusal."""
    bounds = {
        kind: getattr(limit, kind) for limit in field.metadata for kind in ("ge", "gt", "le") if hasattr(limit, kind)
    }
    if bounds:
        yield from (
            ("eleven", "number"),
            ("1e400", "number" if "int" in str(field.annotation) else "at most"),
            ("nan", ""),
        )
    for kind, words in (("ge", "it must be at least"), ("gt", "it must be more than"), ("le", "it must be at most")):
        if kind in bounds:
            yield str(bounds[kind] + {"ge": -1, "gt": 0, "le": 1}[kind]), words
    if field.annotation is bool:
        yield "maybe", "it must be true or false"
    if "Literal" in str(field.annotation) or issubclass(_type(field), enum.Enum):
        yield "maybe", "it is one of '"
    yield from _WRONG.get(name, ())


def _wrong_variables(name: str) -> Iterator[tuple[str, str, str]]:
    """Yield variables of a setting with what is wrong in them: its values, what no text may have, and secret files."""
    field, variable = Settings.model_fields[name], f"KLEINKRAM_{name.upper()}"
    for value, words in _wrong_values(name, field):
        yield variable, value, words
    if not isinstance(field.default, tuple):  # an empty list of networks is one
        yield variable, "", "is empty: set it, or unset it"
        yield variable, "hunter22\nhunter22", "contains a line break"
        yield variable, "hunter22\n", "begins or ends with white space"
    if is_secret(name):
        yield f"{variable}_FILE", "/nowhere/secret", "/nowhere/secret cannot be read (No such file or directory)"
        yield f"{variable}_FILE", "/", "/ cannot be read (Is a directory)"
        yield f"{variable}_FILE", "/dev/null", "/dev/null is empty"
        yield f"{variable}_FILE", "hunter22", "what it names (not an absolute path) cannot be read"


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
    assert "KLEINKRAM_VIEWERS does not hold JSON; docs/reference/settings.md shows its form." in _refusal()


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


@pytest.mark.parametrize("name", [*Settings.model_fields])
def test_check_answers_every_wrong_value_of_a_setting_with_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    wrong_values = [*_wrong_values(name, Settings.model_fields[name])]
    assert wrong_values or name in _WRONG_ON_THIS_MACHINE, "the table says nothing of this setting"
    for variable, value, words in _wrong_variables(name):
        with monkeypatch.context() as patch:
            if variable.endswith("_FILE"):
                patch.delenv(variable.removesuffix("_FILE"), raising=False)
            if "no password" in words:
                patch.setenv(variable.replace("PASSWORD", "URL"), "postgresql://me:hunter22@db/kleinkram")
            patch.setenv(variable, value)
            assert checks.main(as_json=False) == 1, (variable, value)
        printed = capsys.readouterr()
        problems = [line for line in printed.out.splitlines() if line.startswith("PROBLEM settings: ")]
        assert any(words in line for line in problems), (variable, value, problems)
        assert all(variable in line and line.endswith((".", ".)")) for line in problems), (variable, value, problems)
        assert "hunter22" not in printed.out + printed.err, (variable, value)


def test_check_notices_what_this_machine_does_not_have(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("KLEINKRAM_METRICS_PORT", "9101")
    for name, (value, _) in _WRONG_ON_THIS_MACHINE.items():
        monkeypatch.setenv(f"KLEINKRAM_{name.upper()}", value)
    settings = load_settings()
    results = [*checks._optional(settings), *checks._machine(settings)]
    for name, (_, words) in _WRONG_ON_THIS_MACHINE.items():
        (diagnostic,) = [result for result in results if words in result.message]
        assert diagnostic.severity.value == "problem"
        assert f"KLEINKRAM_{name.upper()}" in diagnostic.remedy


def test_the_process_prints_the_sentence_and_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    command = [sys.executable, "-m", "kleinkram.server", "check"]
    monkeypatch.setenv("KLEINKRAM_S3_CA_FILE", "/nowhere/ca.pem")
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (1, "")
    assert "PROBLEM settings: KLEINKRAM_S3_CA_FILE: /nowhere/ca.pem cannot be read" in ran.stdout


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
