"""Times at which something ends, as requests say them."""

import datetime
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime

# Within what databases and languages keep, in every zone.
_FIRST_YEAR, _LAST_YEAR = 2, 9998


def check_expiry(at: datetime.datetime) -> datetime.datetime:
    """Return a time in UTC, or say why nothing can end then.

    Raises:
        ValueError: it is before the year 2 or beyond the year 9998.
    """
    if at.year < _FIRST_YEAR:
        raise ValueError("has passed already")
    if at.year > _LAST_YEAR:
        raise ValueError(f"is beyond the year {_LAST_YEAR}; leave it out for no end")
    return at.astimezone(datetime.timezone.utc)


# When something ends; null, where that is allowed, is never.
Expiry = Annotated[AwareDatetime, AfterValidator(check_expiry)]
