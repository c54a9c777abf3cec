"""Checks of transforms: all frames make one tree."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from kleinkram.checks.content.probe import Probe, RecordedTopic, SampledMessage, measured
from kleinkram.checks.document import TransformRule
from kleinkram.checks.outcomes import failed, make_check
from kleinkram.contract.checks import Check, CheckStatus
from kleinkram.recordings.decoding import DecodeError
from kleinkram.recordings.decoding.values import part, type_name

_MAX_FRAMES, _SHOWN = 10_000, 10


class TransformProbe(Probe[TransformRule]):
    """The check of all transforms that a rule names, over topics and recordings."""

    def __init__(
        self, rule: TransformRule, names: tuple[str, ...], streams: tuple[RecordedTopic, ...], *, is_exact: bool
    ) -> None:
        super().__init__(rule, names, streams[0], is_exact=is_exact)
        self._topics = sorted({stream.topic for stream in streams})
        self._parents: dict[str, str] = {}

    def measure(self, sample: SampledMessage) -> None:
        """Join the frames that a message connects."""
        for transform in [sample.value] if part(sample.value, "transforms") is None else transforms_of(sample.value):
            parent = part(part(transform, "header"), "frame_id") or part(transform, "parent_frame_id")
            child = part(transform, "child_frame_id")
            if not isinstance(parent, str) or not isinstance(child, str) or not parent or not child:
                raise DecodeError(type_name(sample.value), "it has no transform between two frames")
            if len(self._parents) < _MAX_FRAMES:
                self._parents[self._root(parent.lstrip("/"))] = self._root(child.lstrip("/"))

    def results(self) -> Iterator[Check]:
        """Yield the check of the tree."""
        expected = [frame.lstrip("/") for frame in self.rule.frames] or sorted(self._parents)
        missing = [frame for frame in expected if frame not in self._parents]
        trees: dict[str, list[str]] = {}
        for frame in expected:
            if frame in self._parents:
                trees.setdefault(self._root(frame), []).append(frame)
        parts = sorted(trees.values(), key=lambda frames: (-len(frames), frames))
        if missing:
            message = f"no transform has the frame {_listed(missing)}"
        elif len(parts) > 1:
            separate = "; ".join(_listed(frames) for frames in parts[:_SHOWN])
            message = f"the frames make {len(parts)} trees that are not connected: {separate}"
        elif not parts:
            yield self._row(CheckStatus.not_made, "there is no transform")
            return
        else:
            message = f"{len(parts[0])} frames make one tree"
        fails = bool(missing) or len(parts) > 1
        status = failed(self.rule.severity) if fails else CheckStatus.ok
        yield self._row(status, message, value=len(parts) + len(missing))

    def _row(self, status: CheckStatus, message: str, value: float | None = None) -> Check:
        topic = ", ".join(self._topics)
        return make_check(self.names[0], status, message, topic=topic, measured=measured(value, 1, "trees"))

    def _root(self, frame: str) -> str:
        """Return the representative of the frames that are connected with a frame."""
        self._parents.setdefault(frame, frame)
        while (above := self._parents[frame]) != frame:
            self._parents[frame] = frame = self._parents[above]
        return frame


def transforms_of(value: object) -> list[object]:
    """Return the transforms in a message; none where it has no list of them."""
    transforms = part(value, "transforms")
    if isinstance(transforms, Mapping | str | bytes) or not hasattr(transforms, "__len__"):
        return []
    return [transforms[number] for number in range(len(transforms))]


def _listed(names: list[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")
