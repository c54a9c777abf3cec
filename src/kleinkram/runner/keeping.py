"""Keeping what a run left: read as a stranger's word, sent to the store, and told to the server."""

import datetime
import logging
import math
from collections.abc import Sequence

from kleinkram.client._retry import Backoff
from kleinkram.client.errors import ServerUnreachable, StoreUnreachable
from kleinkram.client.transfer.plan import LocalFile
from kleinkram.contract.errors import (
    BodyTooLarge,
    DatabaseUnavailable,
    InvalidRequest,
    KleinkramError,
    RunGone,
    StoreUnavailable,
)
from kleinkram.contract.reports import Progress, Report
from kleinkram.contract.runners import LOG_PATH, RunFinish
from kleinkram.contract.runs import EndReason
from kleinkram.runner import ward
from kleinkram.runner.attempts import Attempt
from kleinkram.runner.ground import Ground
from kleinkram.runner.leaving import Leaving, Refused, artifact_file, log_file
from kleinkram.runner.logs import write_clean
from kleinkram.runner.orders import Orders
from kleinkram.runner.redacting import Redactor
from kleinkram.runner.results import Results, collect
from kleinkram.runner.work import Ending

_CLEAN_LOG = "log.clean"
_JOURNALS = "journals"
_MOST_CHARACTERS = 2000
_MOST_PROBLEMS = 200
_MOST_SAID = 200
_ROUNDS = 5
_AGAIN_S = 2.0
# A store that is away over the weekend comes back, and the runner keeps what a run left meanwhile. So it does where the
# server is away; when that is back after more than a quarter of an hour, another runner may be given the run first.
_AWAY_S = 7 * 86400.0
_AWAY = (ServerUnreachable, StoreUnreachable, StoreUnavailable, DatabaseUnavailable)
# A server in trouble comes back; for one that is away is waited as long as it takes.
_PATIENCE_S = 600.0

_log = logging.getLogger("kleinkram.runner")


class Keeping:
    """Keeps what one run left. `end`, from another thread, has `keep` return soon; it may be done again."""

    def __init__(
        self, ground: Ground, attempt: Attempt, orders: Orders, redactor: Redactor, progress: Progress | None
    ) -> None:
        self._ground = ground
        self._claim = attempt.state.claim
        self._folder = attempt.folder
        self._orders = orders
        self._redactor = redactor
        self._leaving: Leaving | None = None
        # What is said of the run meanwhile: how far it came, and what its results waited for.
        self.progress = progress and Progress(fraction=progress.fraction)

    def end(self) -> None:
        """End the sending."""
        if self._leaving is not None:
            self._leaving.end()

    def keep(self, ending: Ending) -> RunFinish:
        """Send artifacts and log, and return what is to be said of the run.

        Raises:
            Told: the run is to end.
            RunGone: it is not this runner's.
        """
        results = collect(self._folder / "out")
        problems = [*results.problems]
        if results.broken is not None:
            problems.append(results.broken)
            if ending.reason is EndReason.done:
                ending = Ending(EndReason.broken_report, results.broken, ending.exit_code)
        if ending.reason is EndReason.cancelled and results.artifacts:
            problems.append(f"It was cancelled: its {len(results.artifacts)} files are not kept.")
            results.artifacts.clear()
        refused = self._send_all(results)
        problems += [f"{_named(each.path)} was not kept: {each.why}" for each in refused]
        if ending.reason is EndReason.done and any(each.path != LOG_PATH for each in refused):
            ending = Ending(EndReason.results_not_kept, problems[-1], ending.exit_code)
        return self._said(ending, results.report, problems)

    def nothing(self, ending: Ending) -> RunFinish:
        """Return what is said of a run that was cancelled while its results were kept."""
        return self._said(ending, Report(), ["It was cancelled while its results were sent: none of them are kept."])

    def no_room(self) -> RunFinish:
        """Return what is said of a run that cannot be seen to its end for want of room."""
        reason, message = ward.NO_ROOM
        problem = "What it left is not kept, or not all of it: its runner had no room to work with."
        return self._said(Ending(EndReason(reason), message), Report(), [problem])

    def finish(self, said: RunFinish) -> None:
        """Tell the server how it ended, for as long as that takes.

        Raises:
            Told: the run is to end.
            RunGone: it is not this runner's.
            KleinkramError: the server does not take it.
        """
        backoff = Backoff(_PATIENCE_S, self._orders.wait)
        left: RunFinish | None = said
        while left is not None:
            left = self._tell(left, backoff)

    def _tell(self, said: RunFinish, backoff: Backoff) -> RunFinish | None:
        """Tell it once; return what is to be told instead, or None once it was heard."""
        try:
            self._ground.runners.with_patience(math.inf, self._orders.wait).finish(self._claim.run_id, said)
            return None
        except RunGone:
            raise
        except (InvalidRequest, BodyTooLarge) as error:
            problem = _short(f"The server did not take its report: {error}")
            if said.problems == [problem]:
                raise
            return said.model_copy(update={"report": Report(), "problems": [problem], "samples": []})
        except KleinkramError as error:
            _log.warning("the end of the run %s is told again: %s", self._claim.run_id, error)
            if not backoff.pause():
                raise
            return said

    def _send_all(self, results: Results) -> list[Refused]:
        out, clean = self._folder / "out", self._folder / _CLEAN_LOG
        files: list[LocalFile] = []
        refused: list[Refused] = []
        if write_clean(self._folder, self._redactor, clean):
            files.append(log_file(clean))
        for artifact in results.artifacts:
            # A name may be another one in NFC, under which the file is not there.
            if (file := artifact_file(out, artifact)) is None:
                refused.append(Refused(artifact.path, "its name is not in the form NFC"))
            else:
                files.append(file)
        return refused + (self._send(files) if files else [])

    def _send(self, files: Sequence[LocalFile]) -> list[Refused]:
        """Send files, and those again that were not taken: what is not kept is gone with the run's folder."""
        claim, rounds = self._claim, 0
        uploads = self._ground.runners.uploads(claim.run_id, claim.attempt)
        away = Backoff(_AWAY_S, self._orders.wait)
        while True:
            self._orders.check()
            self._leaving = Leaving(uploads, self._ground.url, claim, self._folder / _JOURNALS)
            try:
                refused = self._leaving.send(files)
                self._orders.check()
            except RunGone:
                raise
            except KleinkramError as error:
                refused = [Refused(file.path, str(error), may_pass=isinstance(error, _AWAY)) for file in files]
            passing = next((each.why for each in refused if each.may_pass), None)
            if passing is not None:
                self._say_why(passing)
            rounds += not (passing is not None and away.pause())
            if not refused or rounds == _ROUNDS:
                return refused
            _log.warning("what the run %s left is sent again: %s", claim.run_id, refused[0].why)
            left = {each.path for each in refused}
            files = [file for file in files if file.path in left]
            self._orders.wait(_AGAIN_S)

    def _say_why(self, why: str) -> None:
        """Have whoever looks at the run see why it lasts: with the time, as it stands there when all is well again."""
        now = datetime.datetime.now(datetime.timezone.utc)
        said = f"what it left is sent again; at {now:%Y-%m-%d %H:%M}Z: {why.partition('. ')[0]}"
        fraction = self.progress.fraction if self.progress else 1
        self.progress = Progress(fraction=fraction, message=_short(said, _MOST_SAID))

    def _said(self, ending: Ending, report: Report, problems: Sequence[str]) -> RunFinish:
        return RunFinish(
            attempt=self._claim.attempt,
            reason=ending.reason,
            message=_short(ending.message),
            exit_code=ending.exit_code,
            report=report,
            problems=[_short(problem) for problem in problems[:_MOST_PROBLEMS]],
        )


def _named(path: str) -> str:
    return "Its log" if path == LOG_PATH else path


def _short(text: str, most: int = _MOST_CHARACTERS) -> str:
    """Return a text as it can be sent: names of files may hold what is no text."""
    return text.encode(errors="backslashreplace").decode().replace("\0", "")[:most]
