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
_SEE_REFERENCE = "docs/reference/settings.md shows its form"


class SettingsInvalid(Exception):
    """The environment has no valid settings. The text has a line for each problem, and no secrets."""


def load_settings() -> Settings:
    """Return the settings of this process. Raises SettingsInvalid."""
    problems = [_unknown(name) for name, value in sorted(os.environ.items()) if not _is_known(name.upper(), value)]
    faults = {name: fault for name, value in _values().items() if (fault := _malformation(_variable(name), value))}
    try:
        settings = Settings(**_secrets_in_files(faults))  # type: ignore[arg-type]  # validated, whatever they are
    except SettingsError as error:
        named = _FIELD.search(str(error))
        problems.append(f"{_variable(named[1]) if named else 'A setting'} does not hold JSON; {_SEE_REFERENCE}.")
    except ValidationError as error:
        problems += [
            _sentence(issue) for issue in error.errors() if issue["loc"][:1] not in {(name,) for name in faults}
        ]
    if problems or faults:
        raise SettingsInvalid("\n".join([*problems, *faults.values()]))
    return settings


def _secrets_in_files(faults: dict[str, str]) -> dict[str, object]:
    """Return the secrets that files hold, by the names of settings; adds to `faults` what cannot be used."""
    secrets: dict[str, object] = {}
    for name in filter(is_secret, Settings.model_fields):
        variable = _variable(name)
        try:
            text = secret_from_file(variable)
            if text is not None:
                secrets[name] = json.loads(text) if _is_list(name) else text
        except SettingsInvalid as error:
            faults[name] = str(error)
        except json.JSONDecodeError:
            faults[name] = f"{variable}{_FILE}: the file does not hold JSON; {_SEE_REFERENCE}."
        else:
            if text and not _is_list(name) and (fault := _malformation(variable + _FILE, text)):
                faults[name] = fault
    return secrets


def secret_from_file(variable: str) -> str | None:
    """Return the stripped content of the file in `<variable>_FILE`; None if it is not set. Raises SettingsInvalid."""
    environment = _environment()
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


def _environment() -> dict[str, str]:
    """Return the environment ignoring case, like pydantic-settings."""
    return {name.upper(): value for name, value in os.environ.items()}


def known_variables() -> list[str]:
    """Return all variables that a server's environment may have."""
    settings = [_variable(name) for name in Settings.model_fields]
    files = [_variable(name) + _FILE for name in Settings.model_fields if is_secret(name)]
    return sorted([*settings, *files, *(_PREFIX + name for name in ELSEWHERE)])


def _variable(name: str) -> str:
    return _PREFIX + name.upper()


def _values() -> dict[str, str]:
    """Return the values in the environment by the names of settings, except for lists, which are parsed anyway."""
    environment = _environment()
    texts = [name for name in Settings.model_fields if not _is_list(name)]
    return {name: environment[_variable(name)] for name in texts if _variable(name) in environment}


def _is_list(name: str) -> bool:
    return isinstance(Settings.model_fields[name].default, tuple)


def _malformation(variable: str, value: str) -> str | None:
    """Return a sentence if a value is empty, or has what an editor or a shell left in it."""
    if not value:
        return f"{variable} is empty: set it, or unset it."
    if value != value.strip():
        return f"{variable} begins or ends with white space: remove that."
    if not value.isprintable():
        return f"{variable} contains a line break or another control character: remove that."
    return None


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
