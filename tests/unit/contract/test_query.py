"""The query language: text and filter convert into each other; errors name the column."""

import datetime
import re
import uuid
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kleinkram.contract.errors import InvalidQuery
from kleinkram.contract.files import BlobState, ContentState, FileFilter
from kleinkram.contract.metadata import WHERE_EXPRESSION
from kleinkram.contract.query import combined_filter, parse, phrases, render
from kleinkram.contract.search import FileQuery

_ID = uuid.UUID("2b1d0c9e-0000-4000-8000-000000000000")
_DAY = datetime.datetime(2026, 5, 1, tzinfo=datetime.timezone.utc)


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("", {}),
        ("  alps   imu ", {"text": "alps imu"}),
        ('"50% of" the', {"text": '"50% of" the'}),
        ('"topic:/imu" "-x" - 5" 10:30', {"text": 'topic:/imu -x - "5\\"" 10:30'}),
        ("topic:/imu/* topic:/odom", {"topic": ["/imu/*", "/odom"]}),
        ("topic:/imu topic:/imu", {"topic": ["/imu"]}),
        ("type:*/Image", {"message_type": ["*/Image"]}),
        ('path:"a b/*.mcap"', {"path": ["a b/*.mcap"]}),
        (r"path:a\ b\\c", {"path": ["a b\\c"]}),
        ('project:"My lab"', {"project": "My lab"}),
        (
            f"project:{_ID} mission:{_ID} recording:{_ID}",
            dict.fromkeys(("project_id", "mission_id", "recording_id"), _ID),
        ),
        (f"project:{_ID} project:a*", {"project_id": _ID, "project": "a*"}),
        ('event:stumble event:"slip *"', {"event": ["stumble", "slip *"]}),
        ("label=night format=mcap", {"label": ["night"], "format": ["mcap"]}),
        ("content:Broken state:verified", {"content": [ContentState.broken], "state": [BlobState.verified]}),
        ("meta.robot:anymal", {"where": ["robot=anymal"]}),
        ("meta.robot=anymal", {"where": ["robot=anymal"]}),
        ("meta.site.latitude>=47.3", {"where": ["site.latitude>=47.3"]}),
        ('meta.code:"3" meta.code!=3', {"where": ['code="3"', "code!=3"]}),
        ('meta.site:zur* meta.site:"zur*"', {"where": ["site~zur*", 'site="zur*"']}),
        ('meta.site~"Zürich H*"', {"where": ["site~Zürich H*"]}),
        ("size>1GB", {"min_size_bytes": 10**9 + 1}),
        ("size>=1.5GiB size<2TB", {"min_size_bytes": 3 * 2**29, "max_size_bytes": 2 * 10**12 - 1}),
        ("size>1k size>2k size<9k size<8k", {"min_size_bytes": 2001, "max_size_bytes": 7999}),
        ("size:1500", {"min_size_bytes": 1500, "max_size_bytes": 1500}),
        ("duration>=10m duration<=1.5h", {"min_duration_ns": 600 * 10**9, "max_duration_ns": 5400 * 10**9}),
        ("after:2026-05-01", {"recorded_after": _DAY}),
        ("after:2026-05", {"recorded_after": _DAY}),
        ("before:2026-05-01T02:00+02:00", {"recorded_before": _DAY}),
        ("after:2025 after:2026-05 before:2027 before:2026-05-01", {"recorded_after": _DAY, "recorded_before": _DAY}),
        ("month:2026-05", {"month": ["2026-05"]}),
        ('-label:"night" -alps -size>1GB -meta.x=3', {"without": ["label:night", "alps", "size>1GB", "meta.x:3"]}),
        ('-""', {}),
    ],
)
def test_queries_are_parsed_to_filters(text: str, fields: dict[str, Any]) -> None:
    assert parse(text) == FileFilter(**fields)
    assert parse(render(parse(text))) == parse(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("-label:night size>=1000MB alps", "alps size>=1GB -label:night"),
        ("size>=1000000001", "size>1GB"),
        ("size<=1073741823", "size<1GiB"),
        ("size<=7", "size<8B"),
        ("size>=0", "size>=0B"),
        ("duration>=600s", "duration>=10m"),
        ("duration>0.2s", "duration>200ms"),
        ("before:2026-05-01T00:00Z after:2026-05-01T10:00", "after:2026-05-01T10:00:00Z before:2026-05-01"),
        ("meta.robot=anymal label:a format:mcap project:x", "project:x meta.robot:anymal label:a format:mcap"),
        ('project:"Town"', "project:Town"),
    ],
)
def test_queries_are_normalized(text: str, message: str) -> None:
    assert render(parse(text)) == message


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("alps topc:/imu", 6, "did you mean 'topic'?"),
        ("robot:anymal", 1, "write metadata as meta.robot:anymal"),
        ("http://x", 1, "text in quotes"),
        ("topic:", 1, "it has no value; write it like topic:/imu/*"),
        ("meta.robot:", 1, "it has no value"),
        ("meta.a..b:3", 1, "an empty part"),
        ("a topic>3", 3, "topic does not support >"),
        ("size:big", 1, "kB, MB, GB, TB"),
        ("size>1apple", 1, "kB, MB, GB, TB"),
        ("size<0", 1, "nothing is smaller than 0"),
        ("size>99999999TB", 1, "the number is too large"),
        ("duration>10", 1, "a number with d, h, m, s"),
        ("after:yesterday", 1, "2026-05-01"),
        ("after:2026-02-30", 1, "2026-05-01"),
        ("month:2026-13", 1, "2026-05"),
        ("content:bad", 1, "one of pending, indexed, recovered"),
        ("recording:front", 1, "recording:ID"),
        ("event:", 1, "it has no value; write it like event:stumble"),
        ("evnt:x", 1, "did you mean 'event'?"),
        (f"recording:{uuid.UUID(int=1)} recording:{uuid.UUID(int=2)}", 48, "already set at column 1"),
        ('alps "50% of', 6, "the quote that opens at column 6 is not closed"),
        ('alps topic:"/a"b', 15, "a space is missing after the quote"),
        ("a -topc:/x", 3, "did you mean 'topic'?"),
        ("a\x00", 1, "U+0000"),
        (" ".join(f"label:{number}" for number in range(51)), 1, "50"),
        ("x" * 1025, 1, "1024"),
    ],
)
def test_unreadable_queries_name_the_column(text: str, column: int, words: str) -> None:
    with pytest.raises(InvalidQuery) as caught:
        parse(text)
    assert caught.value.column == column
    assert words in str(caught.value)


@pytest.mark.parametrize("field", ["without", "where"])
def test_filters_with_invalid_terms_cannot_be_rendered(field: str) -> None:
    matching = FileFilter.model_validate({field: ["a b"]})
    with pytest.raises(InvalidQuery):
        render(matching)


def test_a_query_and_a_filter_are_combined() -> None:
    requested = FileQuery(query="alps label:a size>1GB", text="rain", label=["b"], min_size_bytes=5, content=["broken"])
    assert render(combined_filter(requested)) == "alps rain label:a label:b content:broken size>1GB"
    assert type(combined_filter(FileQuery(text="rain"))) is FileFilter
    assert combined_filter(FileQuery(text="rain")) == FileFilter(text="rain")


def test_several_projects_or_missions_mean_any_of_them() -> None:
    first, second = str(uuid.UUID(int=1)), str(uuid.UUID(int=2))
    assert parse("project:a project:b*") == FileFilter(projects=["a", "b*"])
    assert parse(f"mission:{first} mission:{second}") == FileFilter(missions=[first, second])
    assert parse("project:a project:a") == FileFilter(project="a")
    for matching in (FileFilter(projects=["a", "b c"]), FileFilter(missions=[first, second, "night"], project="a")):
        assert parse(render(matching)) == matching
    with pytest.raises(InvalidQuery, match="already set at column 1"):
        combined_filter(FileQuery(query="project:a", projects=["b", "c"]))  # both would have to hold


_text = st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=12)
_value = st.text(st.sampled_from('ab"\\ *?:=-<>~.é\t3'), max_size=8) | _text
_size = st.integers(0, 2**63 - 1) | st.integers(0, 3000)
_time = st.datetimes(min_value=datetime.datetime(2, 1, 1), max_value=datetime.datetime(9998, 1, 1))
_zoned = st.builds(lambda at: at.replace(tzinfo=datetime.timezone.utc), _time)
_line = _value.map(lambda text: " ".join(text.splitlines()).strip()).filter(
    lambda text: "\n" not in text and text != ""
)
_where = st.builds(
    "{}{}{}".format, st.sampled_from(["a", "site.lat"]), st.sampled_from(["=", "!=", "<", ">=", "~"]), _line
)
_filters = st.builds(
    FileFilter,
    text=st.none() | _value,
    project=st.none() | _value.filter(lambda name: name != ""),
    project_id=st.none() | st.uuids(),
    mission=st.none() | _value,
    mission_id=st.none() | st.uuids(),
    recording_id=st.none() | st.uuids(),
    **{
        name: st.lists(_value, max_size=3, unique=True) for name in ("path", "topic", "message_type", "format", "label")
    },
    where=st.lists(_where, max_size=2, unique=True),
    state=st.lists(st.sampled_from(BlobState), max_size=2, unique=True),
    content=st.lists(st.sampled_from(ContentState), max_size=2, unique=True),
    recorded_after=st.none() | _zoned,
    recorded_before=st.none() | _zoned,
    min_size_bytes=st.none() | _size,
    max_size_bytes=st.none() | _size,
    min_duration_ns=st.none() | _size,
    max_duration_ns=st.none() | _size,
    month=st.lists(st.sampled_from(["2026-05", "1999-12"]), max_size=2, unique=True),
)


@given(_filters, st.lists(_filters, max_size=2))
def test_rendered_filters_parse_to_the_same_filter(plain: FileFilter, others: list[FileFilter]) -> None:
    """Words and comparisons may be spelled in more ways than one: these come back in the one spelling."""
    terms = [f"-{term}" for other in others for term in map(render, _single(other))][:50]
    matching = plain.model_copy(update={"without": parse(" ".join(terms)).without})
    text = render(matching)
    again = parse(text)
    spelled = {"text", "where"}
    assert again.model_dump(exclude=spelled) == matching.model_dump(exclude=spelled)
    assert phrases(again.text or "") == phrases(matching.text or "")
    assert [*map(_meaning, again.where)] == [*dict.fromkeys(map(_meaning, matching.where))]
    assert parse(render(again)) == again


def _meaning(expression: str) -> tuple[str, str, str, bool]:
    """Return what a comparison says: quotes matter where the value could be read as something else than text."""
    actual = WHERE_EXPRESSION.fullmatch(expression)
    assert actual is not None
    value = actual["value"].strip()
    is_quoted = len(value) > 1 and value.startswith('"') and value.endswith('"') and actual["operator"] != "~"
    text = value[1:-1] if is_quoted else value
    could_be_else = re.search("[0-9]|true|false", text, re.IGNORECASE) is not None and not set("*?") & set(text)
    return actual["field"], actual["operator"], text, is_quoted and could_be_else


def _single(matching: FileFilter) -> list[FileFilter]:
    """Return filters that say one thing each."""
    actual = []
    for name, value in matching.model_dump(exclude_defaults=True).items():
        values = [[item] for item in value] if isinstance(value, list) else [value]
        actual += [FileFilter.model_validate({name: item}) for item in values if name != "text"]
    return [*actual, *(FileFilter(text=f'"{word}"') for word in phrases(matching.text or "") if word.isalnum())]


@given(_value)
def test_any_text_parses_or_raises_invalid_query(text: str) -> None:
    try:
        matching = parse(text)
    except InvalidQuery as error:
        column = error.column
    else:
        assert parse(render(matching)) == matching
        return
    assert column is not None
    assert 1 <= column <= len(text)
