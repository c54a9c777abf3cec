"""E-mail addresses: which are taken, and when two are the same.

Only ASCII: addresses that look alike, or become alike when their case is folded, must never open somebody else's door.
"""

import re
from typing import Annotated

from pydantic import AfterValidator, Field

MAX_EMAIL_CHARACTERS = 254

# Source: RFC 5321, section 4.1.2, dot-string local parts and domains of letters, digits and hyphens.
_LOCAL = r"[A-Za-z0-9!#$%&'*+/=?^_`{|}~-]+(\.[A-Za-z0-9!#$%&'*+/=?^_`{|}~-]+)*"
_DOMAIN = r"[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?)*"
_ADDRESS = re.compile(f"{_LOCAL}@{_DOMAIN}")
_WHOLE_DOMAIN = re.compile(_DOMAIN)


def check_email(address: str) -> str:
    """Return an address as it is, or say why it is none that is taken.

    Raises:
        ValueError: it has no form of `name@domain`, is too long, or holds letters beyond ASCII.
    """
    if len(address) > MAX_EMAIL_CHARACTERS or not _ADDRESS.fullmatch(address):
        raise ValueError("is not an address such as ada@lab.example (a domain beyond ASCII is written as xn--…)")
    return address


def check_domain(domain: str) -> str:
    """Return a domain in lower case, or say why it is none.

    Raises:
        ValueError: it is not the part of an address after the @.
    """
    if not _WHOLE_DOMAIN.fullmatch(domain):
        raise ValueError("is not a domain such as lab.example, without @ and wildcards")
    return domain.lower()


def email_key(address: str) -> str:
    """Return the form under which an address is one person's: letter case does not count."""
    return address.lower()


def email_domain(address: str) -> str:
    """Return what stands after the last @, in lower case."""
    return address.rpartition("@")[2].lower()


EmailAddress = Annotated[str, AfterValidator(check_email), Field(min_length=3, max_length=MAX_EMAIL_CHARACTERS)]
EmailDomain = Annotated[str, AfterValidator(check_domain), Field(min_length=1, max_length=253)]
