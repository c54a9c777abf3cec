"""What `klein up` says once it answers: where that is, and on a terminal how its owner gets in with a browser."""

import http.client
import shlex

from kleinkram.standalone.owner_link import ask_owner_link
from kleinkram.standalone.plan import Plan, UpOptions


def greeting(plan: Plan, options: UpOptions) -> str:
    """Return the one line that programs wait for."""
    line = f"Kleinkram answers at {plan.public_url} (data in {options.data_dir})"
    if not options.is_default_data_dir:
        line += f"; for klein on this machine: export KLEINKRAM_DATA_DIR={shlex.quote(str(options.data_dir))}"
    return line


def invitation(plan: Plan, api_url: str) -> str:
    """Return the line that only a terminal is shown, since it holds a secret: the owner's link, or how to get one."""
    token = plan.data_dir.token_file.read_text(encoding="ascii").strip()
    try:
        link = ask_owner_link(api_url, token, certificate=plan.listening.tls_cert)
    except (OSError, http.client.HTTPException):
        link = None
    if link is None:
        return "To sign a browser in as its owner: `klein session link`"
    return f"To sign a browser in as its owner, once, within minutes: {link} (`klein session link` makes another)"
