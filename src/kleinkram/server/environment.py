"""Reads settings from `KLEINKRAM_` environment variables; unknown ones are errors. Secrets may come from files.

A misspelt security setting must not be ignored silently.
"""

import difflib
import json
import os
import re
from pathlib import Path

from pydantic import ValidationError
from pydantic_core import ErrorDetails
from pydantic_settings import SettingsError

from kleinkram.contract.problems import message_of
from kleinkram.server.settings import Settings, is_secret

_PREFIX = "KLEINKRAM_"
_FILE = "_FILE"
# What the CLI, the SDK, runners, actions, `klein up` and `klein backup` read. A server's environment may have them too.
ELSEWHERE = frozenset(
    {"API", "BACKUP_PASSPHRASE", "BACKUP_PASSPHRASE_FILE", "BACKUP_S3_ACCESS_KEY", "BACKUP_S3_ACCESS_KEY_FILE"}
    | {"BACKUP_S3_CA_FILE", "BACKUP_S3_REGION", "BACKUP_S3_SECRET_KEY", "BACKUP_S3_SECRET_KEY_FILE", "BACKUP_S3_URL"}
    | {"DATA_DIR", "IN", "INSTANCE", "MISSION_ID", "OUT", "PACKAGES", "POSTGRES_BIN"}
    | {"PROJECT_ID", "RUNNER_TOKEN", "RUN_ID", "DEFAULT_IMAGE", "TOKEN", "URL"}
)
# Of tests, benchmarks and `make`.
_DEVELOPMENT = ("BENCH_", "REQUIRE_", "SOAK_", "TEST_", "BACKUP_SEED", "KILLS_SEED", "RECORDINGS")
# Kubernetes and Docker links describe services in the environment of every container, by the service's name.
# Source: Kubernetes, "Service", environment variables.
_OF_A_SERVICE = re.compile(r".*(SERVICE_HOST|SERVICE_PORT(_.+)?|PORT_\d+_(TCP|UDP)(_(PROTO|PORT|ADDR))?)$")
# How pydantic-settings names what it cannot parse.
_FIELD = re.compile(r'field "(\w+)"')
_ADDRESS = re.compile(r"(tcp|udp)://")


class SettingsInvalid(Exception):
    """The environment has no valid settings. The text has a line for each problem, and no secrets."""


def load_settings() -> Settings:
    """Return the settings of this process. Raises SettingsInvalid."""
    problems = [_unknown(name) for name, value in sorted(os.environ.items()) if not _is_known(name.upper(), value)]
    secrets: dict[str, object] = {}
    unread: list[str] = []
    for name in filter(is_secret, Settings.model_fields):
        try:
            text = secret_from_file(_variable(name))
        except SettingsInvalid as error:
            problems.append(str(error))
            unread.append(name)
            continue
        if text is not None:
            secrets[name] = text
    try:
        if "oidc_providers" in secrets:
            secrets["oidc_providers"] = json.loads(str(secrets["oidc_providers"]))
        settings = Settings(**secrets)  # type: ignore[arg-type]  # validated, whatever they are
    except json.JSONDecodeError:
        problems.append(f"{_variable('oidc_providers')}{_FILE}: the file does not hold JSON.")
    except SettingsError as error:
        named = _FIELD.search(str(error))
        problems.append(f"{_variable(named[1]) if named else 'A setting'} does not hold JSON.")
    except ValidationError as error:
        problems += [
            _sentence(issue) for issue in error.errors() if issue["loc"][:1] not in {(name,) for name in unread}
        ]
    if problems:
        raise SettingsInvalid("\n".join(problems))
    return settings


def secret_from_file(variable: str) -> str | None:
    """Return the stripped content of the file in `<variable>_FILE`; None if it is not set. Raises SettingsInvalid."""
    # Ignoring case, like pydantic-settings.
    environment = {name.upper(): value for name, value in os.environ.items()}
    path = environment.get(variable + _FILE)
    if path is None:
        return None
    if variable in environment:
        raise SettingsInvalid(f"{variable} and {variable}{_FILE} are both set: set one of them.")
    try:
        text = Path(path).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text"
        # A value that is no absolute path may be the secret itself: do not show it.
        shown = path if path.startswith("/") else "what it names (not an absolute path)"
        raise SettingsInvalid(f"{variable}{_FILE}: {shown} cannot be read ({why}).") from None
    if not text:
        raise SettingsInvalid(f"{variable}{_FILE}: {path} is empty.")
    return text


def known_variables() -> list[str]:
    """Return all variables that a server's environment may have."""
    settings = [_variable(name) for name in Settings.model_fields]
    files = [_variable(name) + _FILE for name in Settings.model_fields if is_secret(name)]
    return sorted([*settings, *files, *(_PREFIX + name for name in ELSEWHERE)])


def _variable(name: str) -> str:
    return _PREFIX + name.upper()


def _is_known(variable: str, value: str) -> bool:
    if not variable.startswith(_PREFIX) or variable in known_variables():
        return True
    name = variable.removeprefix(_PREFIX)
    if _OF_A_SERVICE.fullmatch(name) or (name.endswith("PORT") and _ADDRESS.match(value)):
        return True
    return name.startswith(_DEVELOPMENT)


def _unknown(variable: str) -> str:
    close = difflib.get_close_matches(variable.upper(), known_variables(), n=1)
    advice = f"did you mean {close[0]}?" if close else "unset it."
    return f"{variable} is not a setting: {advice} (All settings are in docs/reference/settings.md.)"


def _sentence(problem: ErrorDetails) -> str:
    if not problem["loc"]:
        return f"The settings do not fit together: {message_of(problem)}."
    name = str(problem["loc"][0])
    variable, rest = _variable(name), ".".join(str(part) for part in problem["loc"][1:])
    if problem["type"] == "missing" and not rest:
        return f"{variable} is not set: {Settings.model_fields[name].description}"
    return f"{variable}{f' ({rest})' if rest else ''}: {message_of(problem)}."
