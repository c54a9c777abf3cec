"""What was looked up before a search: where its words are said, and whether it finds few files or very many."""

import uuid
from dataclasses import dataclass


@dataclass(frozen=True)
class Said:
    """Where a word is said: ids of projects, missions and files, names of topics; None where these are not named."""

    word: str
    project_ids: tuple[uuid.UUID, ...] | None = None
    mission_ids: tuple[uuid.UUID, ...] | None = None
    file_ids: tuple[uuid.UUID, ...] | None = None
    topics: tuple[str, ...] | None = None

    @property
    def is_nowhere(self) -> bool:
        """Whether nothing at all holds the word."""
        return (self.project_ids, self.mission_ids, self.file_ids, self.topics) == ((), (), (), ())


@dataclass(frozen=True)
class Looked:
    """What is known of the search that a request makes; of other requests nothing."""

    words: tuple[Said, ...] = ()
    # The word by which files are looked up, where few hold it; or whether very many files are found.
    led_by: str | None = None
    finds_many: bool = False
    # Whether everything is gone through that may match.
    goes_through_all: bool = False
    # All files that are found, where these are few, with the missions they are in and their blobs: of those that are
    # seen by who asks.
    file_ids: tuple[uuid.UUID, ...] | None = None
    mission_ids: tuple[uuid.UUID, ...] = ()
    blob_ids: tuple[uuid.UUID, ...] = ()

    @property
    def finds_few(self) -> bool:
        """Whether so few files are found that a list is best sorted, rather than walked in its order."""
        return self.led_by is not None or self.file_ids is not None

    @property
    def finds_nothing(self) -> bool:
        """Whether a word is nowhere, so that there is nothing to look for."""
        return any(each.is_nowhere for each in self.words)

    def of(self, word: str) -> Said:
        """Return where a word is said, as far as that was looked up."""
        return next((each for each in self.words if each.word == word), Said(word))


NOTHING_LOOKED_UP = Looked()
