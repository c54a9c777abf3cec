"""The trash, for programs."""

from kleinkram.client._http import Api, query_of
from kleinkram.client._paging import Listing, pages
from kleinkram.client.references import Ref, known_id, the_one
from kleinkram.contract.trash import TrashNoun, TrashRead


class Trash:
    """`client.trash`."""

    def __init__(self, api: Api) -> None:
        self._api = api

    def list(self, noun: TrashNoun | None = None) -> Listing[TrashRead]:
        """Yield what lies in the trash, latest first."""
        return pages(self._api, "/trash", TrashRead, query_of(None, noun=noun.value if noun else None))

    def get(self, ref: Ref, *, noun: TrashNoun | None = None) -> TrashRead:
        """Return the thing in the trash with this id or name.

        Raises:
            NotFound: there is none.
            AmbiguousName: several have that name.
        """
        rows = self.list(noun)
        what = noun.value if noun else "deleted thing"
        if (noun_id := known_id(ref, what)) is not None:
            return the_one(what, str(noun_id), rows, name=lambda row: str(row.id), label=trash_label)
        return the_one(what, str(ref), rows, name=lambda row: row.name, label=trash_label)

    def restore(self, noun: TrashNoun, ref: Ref) -> None:
        """Put a deleted thing, by its id or name, back where it was.

        Raises:
            NameTaken, FileExists: something else has its name now.
            NotFound: it is not in the trash.
        """
        self._api.post_empty(f"/trash/{noun.value}/{known_id(ref, noun.value) or self.get(ref, noun=noun).id}/restore")


def trash_label(row: TrashRead) -> str:
    """Return how a deleted thing is listed among candidates."""
    return (
        f"{row.noun.value} {row.place}/{row.name} ({row.id})"
        if row.place
        else f"{row.noun.value} {row.name} ({row.id})"
    )
