"""What was looked up before a search: where its words are said, and whether it finds few files or very many.

Ids and names are kept as the array that PostgreSQL wrote of them (`db.Written`): of thousands, none is read here.
"""

from dataclasses import dataclass

NONE_AT_ALL = "{}"


@dataclass(frozen=True)
class Said:
    """Where a word is said: ids of projects, missions and files, names and types of topics; None where not named.

    Where it `is_general` it stands for any word of which as much is known: `word` is only what its values are called,
    and `is_escaped` whether JSON writes it otherwise than it is.
    """

    word: str
    project_ids: str | None = None
    mission_ids: str | None = None
    file_ids: str | None = None
    topics: str | None = None
    types: str | None = None
    is_general: bool = False
    is_escaped: bool = False

    @property
    def is_nowhere(self) -> bool:
        """Whether nothing at all holds the word."""
        known = {self.project_ids, self.mission_ids, self.file_ids, self.topics, self.types}
        return known == {NONE_AT_ALL}


@dataclass(frozen=True)
class Found:
    """All files that are found, where these are few, with the missions they are in and their blobs.

    Of those that are seen by who asks; `first` are those that a page of them begins with. Where it `is_general` it
    stands for whatever was found.
    """

    file_count: int
    file_ids: str
    mission_ids: str
    blob_ids: str
    first: str
    is_general: bool = False


@dataclass(frozen=True)
class Looked:
    """What is known of the search that a request makes; of other requests nothing."""

    words: tuple[Said, ...] = ()
    # The word by which files are looked up, where few hold it; or whether very many files are found.
    led_by: str | None = None
    finds_many: bool = False
    # Whether it is known that all of those are files without a time.
    is_untimed: bool = False
    # Whether everything is gone through that may match.
    goes_through_all: bool = False
    # Whether files are asked about mission by mission, each time within a statement of its own.
    asks_missions: bool = False
    found: Found | None = None

    @property
    def finds_few(self) -> bool:
        """Whether so few files are found that a list is best sorted, rather than walked in its order."""
        return self.led_by is not None or self.found is not None

    @property
    def finds_nothing(self) -> bool:
        """Whether a word is nowhere, so that there is nothing to look for."""
        return any(each.is_nowhere for each in self.words)

    def of(self, word: str) -> Said:
        """Return where a word is said, as far as that was looked up."""
        return next((each for each in self.words if each.word == word), Said(word))


NOTHING_LOOKED_UP = Looked()
