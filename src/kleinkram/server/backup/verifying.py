"""Saying of backups whether they could be restored: at a glance by names and sizes, or by reading every byte."""

from dataclasses import dataclass, field

from kleinkram.server.backup.copying import side_by_side
from kleinkram.server.backup.failing import Damaged
from kleinkram.server.backup.locking import at_work
from kleinkram.server.backup.names import Names
from kleinkram.server.backup.pace import Pace, amount, telling
from kleinkram.server.backup.problems import Problems
from kleinkram.server.backup.repository import Repository, open_place, open_repository
from kleinkram.server.backup.snapshot import ObjectEntry, Piece, Snapshot


@dataclass
class Verified:
    """What was found."""

    snapshots: int = 0
    contents: int = 0
    content_bytes: int = 0
    read_bytes: int = 0
    unused: int = 0
    unused_bytes: int = 0
    lost_at_source: int = 0
    damage: Problems = field(default_factory=Problems)


@dataclass(frozen=True)
class Looking:
    """How backups are to be looked at; all of them where none is named."""

    place: str
    passphrase: str | None
    snapshot_id: str | None
    read_all: bool
    bytes_per_s: float | None
    at_once: int
    quiet: bool


async def verify(looking: Looking) -> Verified:
    """Look at backups.

    Raises:
        BackupError: there are none, or they cannot be opened. Damage is no error, but what is returned.
    """
    verified = Verified()
    async with open_place(looking.place) as shelf, at_work(shelf, alone=False):
        repository = await open_repository(shelf, looking.passphrase)
        ids = [looking.snapshot_id] if looking.snapshot_id else await repository.snapshot_ids()
        pace = Pace(looking.bytes_per_s)

        def so_far() -> str:
            return f"verify: {verified.snapshots} of {len(ids)} backups, {amount(pace.seen_bytes)} read"

        async with telling(so_far, quiet=looking.quiet):
            names = await repository.held()
            verified.contents, verified.content_bytes = len(names), names.total_bytes()
            for snapshot_id in ids:
                await _look_at(repository, snapshot_id, names, verified)
            if looking.read_all:
                check = _Reading(repository, names, pace, verified)
                places = (place for place in range(len(names)) if looking.snapshot_id is None or names.marked(place))
                await side_by_side(places, check.read, looking.at_once)
                verified.read_bytes = pace.seen_bytes
        unused = [] if looking.snapshot_id else [size_bytes for _, size_bytes in names.unmarked()]
        verified.unused, verified.unused_bytes = len(unused), sum(unused)
    return verified


async def mark(repository: Repository, snapshot: Snapshot, names: Names, verified: Verified) -> None:
    """Mark all that a backup names, and note what of it is not there, or of another size.

    Raises:
        Damaged: its list of objects cannot be read.
    """
    look = _Marking(repository, names, verified, snapshot.id)
    for table in snapshot.tables:
        for piece in table.pieces:
            look.at(bytes.fromhex(piece.sha256), piece.size_bytes, f"a piece of the table {table.name}")
    for piece in snapshot.objects.pieces:
        look.at(bytes.fromhex(piece.sha256), piece.size_bytes, "a piece of its list of objects")
        await look.at_objects(piece)


async def _look_at(repository: Repository, snapshot_id: str, names: Names, verified: Verified) -> None:
    verified.snapshots += 1
    try:
        await mark(repository, await repository.snapshot(snapshot_id), names, verified)
    except Damaged as error:
        verified.damage.say(f"The backup {snapshot_id} cannot be restored: {error}")


@dataclass(frozen=True)
class _Marking:
    repository: Repository
    names: Names
    verified: Verified
    snapshot_id: str

    def at(self, sha256: bytes, size_bytes: int | None, what: str) -> None:
        """See that one content is there."""
        place = self.names.place(self.repository.name(sha256))
        if place is None:
            self._say(f"{what} is missing ({self.repository.path(self.repository.name(sha256))})")
            return
        self.names.mark(place)
        found = self.names.size_bytes(self.repository.name(sha256))
        if size_bytes is not None and found != self.repository.stored_size(size_bytes):
            path = self.repository.path(self.repository.name(sha256))
            self._say(f"{what} has {found} bytes and should have {self.repository.stored_size(size_bytes)} ({path})")

    async def at_objects(self, piece: Piece) -> None:
        """See to all objects of one piece of the list."""
        for line in (await self.repository.read_packed(piece)).splitlines():
            entry = ObjectEntry.model_validate_json(line)
            if entry.sha256 is None:
                self.verified.lost_at_source += 1
                continue
            # Of what was corrupt only its own size is known, by its name.
            size_bytes = None if entry.problem else entry.size_bytes
            self.at(bytes.fromhex(entry.sha256), size_bytes, f"the object {entry.key}")

    def _say(self, words: str) -> None:
        self.verified.damage.say(f"In the backup {self.snapshot_id}, {words}.")


@dataclass(frozen=True)
class _Reading:
    repository: Repository
    names: Names
    pace: Pace
    verified: Verified

    async def read(self, place: int) -> None:
        """Read one content through."""
        name = self.names[place]
        try:
            await self.repository.verify(name, self.pace)
        except (Damaged, FileNotFoundError) as error:
            self.verified.damage.say(str(error))
