"""One run from its claim to its end, in a thread of its own.

Each step is written down before it is done, and may be done again: a runner that was killed finds its run where it was.
"""

import contextlib
import logging
import math
import threading
from collections.abc import Callable

from kleinkram.contract.errors import KleinkramError, RunGone
from kleinkram.contract.runners import Heartbeat, HeartbeatReply, LeaseStatus, RunAssignment, RunFinish
from kleinkram.contract.runs import EndReason, RunState, UsageSample
from kleinkram.runner.attempts import Attempt, EndingNoted, Stage
from kleinkram.runner.disk import FULL, remove_tree
from kleinkram.runner.ground import Ground, work_of
from kleinkram.runner.keeping import Keeping
from kleinkram.runner.logs import LogFollower
from kleinkram.runner.orders import Lease, Order, Orders, Told
from kleinkram.runner.preparing import Preparing
from kleinkram.runner.progress import ProgressReader
from kleinkram.runner.redacting import Redactor
from kleinkram.runner.ward import now_s
from kleinkram.runner.work import CannotStart, Ending

_log = logging.getLogger("kleinkram.runner")
_LOOK_S = 0.5
_SAMPLE_EVERY_S = 5.0
_MOST_SAMPLES = 100
# A run that goes down with its machine each time is not started for ever.
_STARTS = 3
_STOP_EVERY_S = 1.0
_STATES = {
    Stage.preparing: RunState.preparing,
    Stage.running: RunState.running,
    Stage.collecting: RunState.collecting,
}


class HeldRun:
    """A run that is this runner's. All but `start` may be called from any thread."""

    def __init__(
        self, ground: Ground, attempt: Attempt, lease: Lease, *, is_new: bool, over: Callable[["HeldRun"], None]
    ) -> None:
        self.orders = Orders()
        self.lease = lease
        self._ground = ground
        self._attempt = attempt
        self._over = over
        self._state = _STATES[attempt.state.stage]
        self._has_word = threading.Event()
        if is_new:
            self._has_word.set()
        self._is_started = attempt.state.stage is Stage.running
        self._samples: list[UsageSample] = []
        self._usage = attempt.state.usage
        self._progress = ProgressReader(attempt.folder / "out")
        self._redactor = Redactor([token for token in (ground.token, attempt.state.claim.token) if token])
        self._log = LogFollower(ground.runners, ground.store, attempt.state.claim, attempt.folder, self._redactor)
        self._stopped_s = -math.inf
        self._can_be_stopped = True
        self._keeping: Keeping | None = None
        self._thread = threading.Thread(target=self._run, name=f"run {attempt.key[:8]}", daemon=True)

    @property
    def claim(self) -> RunAssignment:
        """What it is."""
        return self._attempt.state.claim

    def start(self) -> None:
        """Begin, or go on with it."""
        self._thread.start()

    def join(self, timeout_s: float) -> None:
        """Wait until its thread is over."""
        self._thread.join(timeout_s)

    def beat(self) -> Heartbeat:
        """Return what is to be said of it."""
        return Heartbeat(
            run_id=self.claim.run_id,
            attempt=self.claim.attempt,
            state=self._state,
            progress=self._keeping.progress if self._keeping else self._progress.progress,
            image_digest=self._attempt.state.image_digest,
            usage=self._usage,
            samples=self._samples[:_MOST_SAMPLES],
        )

    def answered(self, beat: Heartbeat, answer: HeartbeatReply, *, asked_s: float, lease_s: float) -> None:
        """Take what the server said to a beat that was sent at `asked_s`."""
        if answer.status is LeaseStatus.lost:
            self.orders.give(Order.let_go)
            return
        self.lease.renew(asked_s, lease_s)
        with contextlib.suppress(
            OSError
        ):  # it has not begun, or its folder is gone, or the disk broke: then it ends early
            self.lease.note_again(self._attempt.folder)
        del self._samples[: len(beat.samples)]
        self._has_word.set()
        if answer.status is LeaseStatus.cancel:
            self.orders.give(Order.cancel)

    def press(self) -> None:
        """See that it is not held for too long, and that orders are followed by what goes on meanwhile."""
        if self._state is not RunState.collecting and self.lease.is_over():
            if self.orders.order is not Order.let_go:
                _log.warning("the run %s is ended: the server was not reached for too long", self.claim.run_id)
            self.orders.give(Order.let_go)
        if not self.orders.is_pending():
            return
        if self._keeping is not None:
            self._keeping.end()
        elif self.orders.order is not Order.leave and self._is_started and now_s() - self._stopped_s > _STOP_EVERY_S:
            self._stopped_s = now_s()
            self._stop()

    def _stop(self) -> None:
        """Ask what runs of it to end; where that fails, the next round does it again."""
        try:
            self._ground.executor.stop(work_of(self._ground, self._attempt))
            self._can_be_stopped = True
        except OSError as error:
            if self._can_be_stopped:
                _log.warning("the run %s cannot be ended yet, and is tried again: %s", self.claim.run_id, error)
            self._can_be_stopped = False

    def kill(self) -> None:
        """Kill what runs of it, once its thread is over: the next runner begins anew with it."""
        self._ground.executor.remove(work_of(self._ground, self._attempt))

    def _run(self) -> None:
        is_left = False
        try:
            self._see_it_through()
        except Told as told:
            is_left = told.order is Order.leave
            if not is_left:
                _log.info("the run %s is not this runner's any more", self.claim.run_id)
        except RunGone:
            _log.info("the run %s is not this runner's any more", self.claim.run_id)
        except (KleinkramError, OSError):
            # Its lease runs out, and the server says what becomes of it.
            _log.exception("the run %s is given up", self.claim.run_id)
        finally:
            if not is_left:
                self._clear()

    def _see_it_through(self) -> None:
        try:
            self._see_to_end_and_results()
        except OSError as error:
            if error.errno not in FULL:
                raise
            _log.error("the run %s is ended, as there is no room here: %s", self.claim.run_id, error)
            self._end_without_room()

    def _see_to_end_and_results(self) -> None:
        if self._attempt.state.stage is not Stage.collecting:
            ending = self._see_to_its_end()
            noted = EndingNoted(reason=ending.reason, message=ending.message, exit_code=ending.exit_code)
            self._attempt.change(stage=Stage.collecting, ending=noted, usage=self._usage)
        self._keep()

    def _see_to_its_end(self) -> Ending:
        try:
            found = self._found_again()
            if found is not None:
                return found
            if self._attempt.state.stage is not Stage.running or not self._is_started:
                self._begin()
            return self._watch()
        except CannotStart as error:
            self._check_held()  # what was starting may have been killed for an order
            return error.ending
        except Told as told:
            if told.order is not Order.cancel:
                raise
            self.orders.obeyed()
            return _cancelled()

    def _found_again(self) -> Ending | None:
        """Look for a run that an earlier runner started, or was about to start; return how it ended, if it did."""
        if not self._is_started:
            return None
        found = self._ground.executor.wait(work_of(self._ground, self._attempt), 0)
        if found is not None and found.reason is EndReason.lost and self._attempt.state.starts < _STARTS:
            self._is_started = False
            return None
        return found

    def _begin(self) -> None:
        while not self._has_word.is_set():
            self.orders.wait(0.05)
        self._now(RunState.preparing)
        self._attempt.change(stage=Stage.preparing)
        self._ground.executor.remove(work_of(self._ground, self._attempt))
        self._attempt.clear()
        ready = Preparing(self._ground, self._attempt, self.orders).prepare()
        self._attempt.change(
            stage=Stage.running,
            starts=self._attempt.state.starts + 1,
            started_s=now_s(),
            image=ready.image.reference if ready.image else None,
            image_digest=ready.image.digest if ready.image else None,
            store_url=ready.store_url,
        )
        self.orders.check()
        if self.lease.is_over():
            raise Told(Order.let_go)
        self.lease.write_down(self._attempt.folder)
        self._ground.executor.start(work_of(self._ground, self._attempt))
        self._is_started = True
        self._attempt.change(started_s=now_s())

    def _watch(self) -> Ending:
        self._now(RunState.running)
        self._log.start()
        sampled_s = -math.inf
        while (ending := self._ground.executor.wait(work_of(self._ground, self._attempt), _LOOK_S)) is None:
            self._check_held()
            self._progress.look()
            if now_s() - sampled_s >= _SAMPLE_EVERY_S:
                sampled_s = now_s()
                self._sample()
        self._check_held()
        self._sample()
        self._progress.look()
        if self.orders.order is Order.cancel:
            self.orders.obeyed()
            return _cancelled(ending.exit_code)
        return ending

    def _check_held(self) -> None:
        """See that it is still this runner's; being cancelled, it ends by itself."""
        if self.orders.order is not Order.cancel:
            self.orders.check()

    def _sample(self) -> None:
        used = self._ground.executor.usage(work_of(self._ground, self._attempt))
        if used is not None:
            self._usage = used
            if len(self._samples) < _MOST_SAMPLES:
                at_s = max(0.0, now_s() - self._attempt.state.started_s)
                self._samples.append(UsageSample(at_s=round(at_s, 3), usage=used))

    def _keep(self) -> None:
        self._now(RunState.collecting)
        self._log.is_whole()
        noted = self._attempt.state.ending
        ending = noted.ending() if noted else Ending(EndReason.lost, "Nobody wrote down how it ended.")
        self._keeping = self._to_keep()
        try:
            self._finish(self._keeping, self._keeping.keep(ending))
        except Told as told:
            if told.order is not Order.cancel:
                raise
            self.orders.obeyed()
            self._finish(self._keeping, self._keeping.nothing(_cancelled(ending.exit_code)))

    def _to_keep(self) -> Keeping:
        return Keeping(self._ground, self._attempt, self.orders, self._redactor, self._progress.progress)

    def _end_without_room(self) -> None:
        """Tell that it is over: given up, it would be started again, to meet the same."""
        if self.orders.order is Order.cancel:
            self.orders.obeyed()
        self.orders.check()
        self._ground.executor.remove(work_of(self._ground, self._attempt))
        self._now(RunState.collecting)
        self._keeping = self._to_keep()
        self._finish(self._keeping, self._keeping.no_room())

    def _finish(self, keeping: Keeping, said: RunFinish) -> None:
        # It says all that beats would have.
        keeping.finish(said.model_copy(update={"usage": self._usage, "samples": self._samples[:_MOST_SAMPLES]}))

    def _now(self, state: RunState) -> None:
        self._state = state
        self._ground.changed()

    def _clear(self) -> None:
        self._log.leave()
        try:
            self._ground.executor.remove(work_of(self._ground, self._attempt))
            remove_tree(self._attempt.folder)
        except OSError as error:
            _log.warning("the folder of the run %s stays for now: %s", self.claim.run_id, error)
        finally:
            self._over(self)


def _cancelled(exit_code: int | None = None) -> Ending:
    return Ending(EndReason.cancelled, "It was cancelled.", exit_code)
