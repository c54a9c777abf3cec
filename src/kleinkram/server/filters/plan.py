"""The plan of a search: what is learnt of a filter before it runs. It decides how rows are read, not who sees them."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

# Ids are random: the rows with the lowest ids are a sample, and the last of these tells how many rows there are.
ID_COUNT = 2**128


@dataclass(frozen=True)
class WordMatches:
    """The projects, topics and message types whose names contain a word; None where there are too many to list."""

    project_ids: Sequence[uuid.UUID] | None = None
    topics: Sequence[str] | None = None
    message_types: Sequence[str] | None = None


@dataclass(frozen=True)
class MatchedFiles:
    """All files that a search finds, where there are few, with their missions and blobs.

    Ids are kept as PostgreSQL writes arrays (`db.Written`), so that none of them is read here. `first_ids` are those
    of the first page, in its order.
    """

    file_count: int
    file_ids: str
    mission_ids: str
    blob_ids: str
    first_ids: Sequence[uuid.UUID]


@dataclass(frozen=True)
class SearchPlan:
    """How a filter is best evaluated.

    Attributes:
        words: by word of the filter's text, where it occurs.
        leading_word: the rarest word, by whose indexes files are looked up.
        is_common: so many files match that a list is read in its order until the page is full.
        matched: the files themselves, once they are known.
        mission_ids: all missions that the actor sees, where these are few.
        has_time: only files with a recording time are to be found, or only those without.
    """

    words: Mapping[str, WordMatches] = field(default_factory=dict)
    leading_word: str | None = None
    is_common: bool = False
    matched: MatchedFiles | None = None
    has_time: bool | None = None
    mission_ids: Sequence[uuid.UUID] | None = None

    @property
    def is_selective(self) -> bool:
        """Whether so few files match that they are looked up and sorted, instead of read in the list's order."""
        return any(each is not None for each in (self.leading_word, self.matched, self.mission_ids))

    def matches_of(self, word: str) -> WordMatches:
        """Return where a word occurs, as far as that is known."""
        return self.words.get(word, WordMatches())


NO_PLAN = SearchPlan()


def rounded(number: int) -> int:
    """Return an estimate in its first two digits: the others are not known."""
    return round(number, -max(len(str(number)) - 2, 0))
