"""The base of the checks of one rule: a probe receives messages in the order of time and ends in checks.

A probe keeps numbers of the messages, never the messages; its memory is bounded.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from functools import cached_property
from typing import Generic, NamedTuple, Protocol, TypeVar

from kleinkram.checks.document import Rule
from kleinkram.checks.outcomes import Measured, failed, make_check
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError, stamp_ns
from kleinkram.recordings.decoding.values import type_name
from kleinkram.recordings.messages import RawMessage
from kleinkram.recordings.recording import decode

_LATEST_NS = 2**63 - 1
R_co = TypeVar("R_co", bound=Rule, covariant=True)


class RecordedTopic(NamedTuple):
    """A topic of one recording."""

    recording: str
    topic: str


class SampledMessage:
    """One message that was read. `is_picked`: it is one of the samples; others were read along with them."""

    def __init__(self, stream: RecordedTopic, message: RawMessage, *, is_picked: bool) -> None:
        self.stream = stream
        self.message = message
        self.is_picked = is_picked

    @property
    def log_time_ns(self) -> int:
        """The log time."""
        return self.message.log_time_ns

    @cached_property
    def value(self) -> object:
        """The decoded message. Raises DecodeError."""
        return decode(self.message)

    @cached_property
    def stamp_ns(self) -> int | None:
        """The stamp in its header; None without one. Raises DecodeError."""
        return checked_stamp(self.value)

    @property
    def time_ns(self) -> int:
        """When it was measured: by its header, or the log time without a stamp. Raises DecodeError."""
        return self.stamp_ns or self.log_time_ns


def checked_stamp(value: object) -> int | None:
    """Return the stamp of a message; None without one. Raises DecodeError, also for a time that no clock has."""
    stamp = stamp_ns(value)
    if stamp is not None and not -_LATEST_NS <= stamp <= _LATEST_NS:
        raise DecodeError(type_name(value), "its stamp is not a time")
    return stamp


def measured(value: float | None, limit: float | None, unit: str | None) -> Measured | None:
    """Return what was measured; None without a finite value."""
    return Measured(value, limit, unit) if value is not None and math.isfinite(value) else None


def number(value: float) -> str:
    """Return a number as text, with at most four digits."""
    return f"{value:.4g}"


class SampleSink(Protocol):
    """Takes the samples of one topic."""

    def add(self, sample: SampledMessage) -> None:
        """Take a message."""

    def note_unread(self, reason: str) -> None:
        """Note why messages could not be read; the first reason counts."""

    def note_damage(self, reason: str) -> None:
        """Note why a part of the messages that were asked for could not be read; the first reason counts."""


class FollowUp(NamedTuple):
    """A place that a probe needs in addition: a log time of a topic."""

    stream: RecordedTopic
    time_ns: int


class Probe(ABC, Generic[R_co]):
    """Checks of one rule on one topic.

    `names`: the checks that it makes. `is_exact`: the rule names the topic, rather than matching it by a glob.
    """

    def __init__(self, rule: R_co, names: tuple[str, ...], stream: RecordedTopic, *, is_exact: bool) -> None:
        self.rule = rule
        self.names = names
        self.stream = stream
        self.is_exact = is_exact
        self.decoded = 0
        self.undecoded = 0
        self.first_error = ""
        self.unread_reason = ""
        self.damage = ""

    def add(self, sample: SampledMessage) -> None:
        """Take a message. One that cannot be decoded is counted."""
        try:
            self.measure(sample)
            self.decoded += 1
        except (DecodeError, OverflowError) as error:  # JSON has integers that no float can represent
            self.undecoded += 1
            self.first_error = self.first_error or str(error)

    def note_unread(self, reason: str) -> None:
        """Note why messages could not be read; the first reason counts."""
        self.unread_reason = self.unread_reason or reason

    def note_damage(self, reason: str) -> None:
        """Note why a part of the messages that were asked for could not be read; the first reason counts."""
        self.damage = self.damage or reason

    @abstractmethod
    def measure(self, sample: SampledMessage) -> None:
        """Take the measures of a message. Raises DecodeError."""

    @abstractmethod
    def results(self) -> Iterator[Check]:
        """Yield the checks; called only if a message was decoded."""

    def follow_ups(self) -> list[FollowUp]:
        """Return what else must be read, once all samples were added."""
        return []

    def checks(self) -> Iterator[Check]:
        """Yield the checks; those that could not be made, with the reason."""
        if self.decoded:
            yield from self.results()
            if self.undecoded:
                total = self.decoded + self.undecoded
                reason = f"{self.undecoded} of {total} messages could not be decoded: {self.first_error}"
                yield self.row(self.names[0], CheckStatus.not_made, reason)
            if self.damage:
                reason = f"a part of the messages could not be read: {self.damage}"
                yield self.row(self.names[0], CheckStatus.not_made, reason)
            return
        if self.undecoded:
            reason = f"its messages cannot be decoded: {self.first_error}"
        else:
            reason = self.unread_reason or "it has no messages"
        for name in self.names:
            yield self.row(name, CheckStatus.not_made, reason)

    def row(
        self,
        name: str,
        status: CheckStatus,
        message: str,
        *,
        value: float | None = None,
        limit: float | None = None,
        unit: str | None = None,
        time_ns: int | None = None,
    ) -> Check:
        """Return a row about the topic."""
        return make_check(
            name,
            status,
            message,
            topic=self.stream.topic,
            file=self.stream.recording,
            time_ns=time_ns,
            measured=measured(value, limit, unit),
        )

    def outcome(
        self,
        name: str,
        message: str,
        *,
        fails: bool,
        value: float | None = None,
        limit: float | None = None,
        unit: str | None = None,
        time_ns: int | None = None,
    ) -> Check:
        """Return the row of a check that was made; `time_ns` is left out if it passed."""
        status = failed(self.rule.severity) if fails else CheckStatus.ok
        return self.row(name, status, message, value=value, limit=limit, unit=unit, time_ns=time_ns if fails else None)
