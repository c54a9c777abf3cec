"""Where a runner's token comes from: the environment, or a file that nobody else can read."""

import os
from pathlib import Path

from kleinkram.client.errors import ConfigurationBroken, CredentialsExposed, NotConfigured

TOKEN_VARIABLE = "KLEINKRAM_RUNNER_TOKEN"  # noqa: S105  the variable's name


def find_token(file: Path | None) -> str:
    """Return the token.

    Raises:
        NotConfigured: there is none.
        CredentialsExposed: others can read the file.
        ConfigurationBroken: it cannot be read.
    """
    if file is None:
        # Taken out: what this process starts has no use for it.
        token = os.environ.pop(TOKEN_VARIABLE, "")
        if not token:
            raise NotConfigured(reason=f"a runner needs its token, in {TOKEN_VARIABLE} or in a file (--token-file)")
        return token.strip()
    try:
        mode = file.stat().st_mode & 0o777
        if mode & 0o077:
            raise CredentialsExposed(file=str(file), mode=f"{mode:o}")
        return file.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationBroken(file=str(file), reason=str(error)) from error
