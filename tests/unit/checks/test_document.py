"""`checks.yaml`: what it may say, the line and column of every kind of error, and its JSON schema."""

import json
from pathlib import Path
from typing import Any

import pytest

from kleinkram.checks.document import MatchedMetadata, Profile, json_schema, read_checks, reference_of
from kleinkram.checks.facts import MissionFacts
from kleinkram.checks.globs import MAX_MATCHED_CHARACTERS
from kleinkram.checks.results import choose_profiles, evaluate_index
from kleinkram.contract.checks import MAX_CHECKS_CHARACTERS, CheckSeverity
from kleinkram.contract.errors import YamlInvalid

HEAD = "version: 1\nprofiles:\n- "


def _invalid(text: str) -> YamlInvalid:
    with pytest.raises(YamlInvalid) as caught:
        read_checks(text)
    return caught.value


def test_units_are_read_as_people_write_them() -> None:
    text = """
version: 1
profiles:
- topics:
    /imu/data: {rate: 200 Hz, tolerance: 5%, max_gap: 50ms, covers: 0.95, max_silence_at_start: 2}
  files:
    "*.mcap": {min_size: 10MB, count: 4}
"""
    profile = read_checks(text).profiles[0]
    imu, file = profile.topics["/imu/data"][0], profile.files["*.mcap"][0]
    assert (imu.rate, imu.tolerance, imu.max_gap, imu.covers) == (200, 0.05, 50_000_000, 0.95)
    assert imu.max_silence_at_start == 2_000_000_000
    assert file.min_size == 10_000_000
    assert file.count is not None
    assert (file.count.min, file.count.max) == (4, 4)


def test_a_name_has_one_rule_or_several_or_only_the_defaults() -> None:
    text = HEAD + "topics:\n    /a: {rate: 1}\n    /b: [{rate: 1}, {max_gap: 2s, severity: warning}]\n    /c:\n"
    topics = read_checks(text).profiles[0].topics
    assert [len(topics[name]) for name in ("/a", "/b", "/c")] == [1, 2, 1]
    assert topics["/b"][1].severity is CheckSeverity.warning
    assert topics["/c"][0].required is True


@pytest.mark.parametrize(
    ("text", "line", "column", "reason"),
    [
        pytest.param("", 1, 1, "it is empty; begin with `version: 1`", id="empty"),
        pytest.param("# only a comment\n", 1, 1, "it is empty", id="only a comment"),
        pytest.param("version: 1\nprofiles: [", 2, 12, "", id="not YAML"),
        pytest.param("- a\n", 1, 1, "it must be a mapping", id="a list"),
        pytest.param("profiles:\n- {}\n", 1, 1, "version: it is required", id="no version"),
        pytest.param("version: 2\nprofiles:\n- {}\n", 1, 1, "version: it is one of 1", id="another version"),
        pytest.param("version: 1\nprofiles: []\n", 2, 1, "profiles: there are fewer than 1", id="no profile"),
        pytest.param("version: 1\nprofiles: 3\n", 2, 1, "profiles: it must be a list", id="profiles is a number"),
        pytest.param(
            "version: 1\nprofiles:\n- {name: a}\n- {name: a}\n", 4, 3, "two profiles are named 'a'", id="one name twice"
        ),
        pytest.param(
            HEAD + "topics:\n    /a: {}\n    /a: {}\n", 5, 5, "the key '/a' is given twice", id="duplicate key"
        ),
        pytest.param(HEAD + "topcs: {}\n", 3, 3, "topcs: there is no such field; did you mean 'topics'?", id="section"),
        pytest.param(HEAD + "topics:\n    /a: {rte: 1}\n", 4, 10, "did you mean 'rate'?", id="unknown key of a rule"),
        pytest.param(
            HEAD + "topics:\n    /a: [{rate: 1}, {maxgap: 1}]\n", 4, 22, "did you mean 'max_gap'?", id="in a list"
        ),
        pytest.param(HEAD + "topics:\n    /a: {count: {minimum: 3}}\n", 4, 18, "did you mean 'min'?", id="of a count"),
        pytest.param(HEAD + "topics:\n    /a: {zzz: 1}\n", 4, 10, "there are severity, required,", id="no near key"),
        pytest.param(HEAD + "topics:\n    /a: {rate: 2 kHz}\n", 4, 10, "a rate such as 200 Hz", id="unit of a rate"),
        pytest.param(HEAD + "topics:\n    /a: {rate: 0}\n", 4, 10, "it must be more than 0", id="rate of zero"),
        pytest.param(HEAD + "topics:\n    /a: {rate: .nan}\n", 4, 10, "a rate such as 200 Hz", id="NaN"),
        pytest.param(HEAD + "topics:\n    /a: {rate: true}\n", 4, 10, "a rate such as 200 Hz", id="truth as a rate"),
        pytest.param(HEAD + "topics:\n    /a: {max_gap: 5 min}\n", 4, 10, "d, h, m, s, ms, us or ns", id="duration"),
        pytest.param(HEAD + "topics:\n    /a: {max_gap: -1}\n", 4, 10, "it must be at least 0", id="negative"),
        pytest.param(HEAD + "topics:\n    /a: {covers: 150%}\n", 4, 10, "it must be at most 1", id="share over 100%"),
        pytest.param(HEAD + "topics:\n    /a: {covers: most}\n", 4, 10, "a share such as 95%", id="share in words"),
        pytest.param(
            HEAD + "topics:\n    /a: {count: {min: 3, max: 1}}\n", 4, 10, "max is smaller than min", id="count range"
        ),
        pytest.param(HEAD + "topics:\n    /a: {type: [b]}\n", 4, 10, "it must be text", id="type is a list"),
        pytest.param(HEAD + "topics:\n    /a: {required: 'yes'}\n", 4, 10, "true or false", id="text for a truth"),
        pytest.param(HEAD + "topics:\n    /a: {severity: fatal}\n", 4, 10, "'warning' or 'error'", id="severity"),
        pytest.param(HEAD + "topics:\n    /a: 200\n", 4, 5, "it must be a mapping", id="rule is a number"),
        pytest.param(HEAD + "topics:\n    /a: []\n", 4, 5, "there are fewer than 1", id="no rule in the list"),
        pytest.param(HEAD + "files:\n    a: {min_size: 3 parrots}\n", 4, 9, "a number with kB, MB", id="size"),
        pytest.param(HEAD + "imu:\n    a: {up: w}\n", 4, 9, "it is one of 'x', '-x'", id="axis"),
        pytest.param(HEAD + "images:\n    a: {min_brightness: 300}\n", 4, 9, "at most 255", id="brightness"),
        pytest.param(
            HEAD + "images:\n    a: {min_brightness: 99, max_brightness: 9}\n",
            4,
            5,
            "more than min_brightness",
            id="dark",
        ),
        pytest.param(
            HEAD + "point_clouds:\n    a: {min_range: 9, max_range: 1}\n", 4, 5, "more than min_range", id="cloud range"
        ),
        pytest.param(HEAD + "values:\n    a: {min: 9, max: 1}\n", 4, 5, "max is smaller than min", id="value range"),
        pytest.param(
            HEAD + "topics:\n    /a: &x {rate: 1}\n    /b: *x\n", 4, 9, "anchors and aliases", id="anchor and alias"
        ),
        pytest.param(HEAD + "topics:\n    /a: !!python/object:os.system {}\n", 4, 9, "tags (!)", id="tag"),
        pytest.param("version: 1\nprofiles:\n- {}\n---\na: 1\n", 4, 1, "a second document", id="two documents"),
        pytest.param("version: 1\nprofiles:\n- name: \x00\n", 3, 9, "U+0000", id="NUL"),
        pytest.param(
            HEAD + f"topics:\n    /a: {{}}\n    '{'*a' * 17}': {{}}\n",
            5,
            5,
            f"topics.{'*a' * 17}: a glob with 17 `*`; at most 16 are allowed",
            id="stars in a name",
        ),
        pytest.param(
            HEAD + f"topics:\n    /a: {{rate: 1, recording: '{'*a' * 17}'}}\n", 4, 19, "17 `*`", id="stars in a value"
        ),
        pytest.param(HEAD + "topics:\n    '': {}\n", 4, 5, "topics.: it is too short", id="empty name"),
        pytest.param(
            f"version: 1\nprofiles:\n- when: {{a: [{'a, ' * 600}a]}}\n- name: b\n  when: {{b: [{'b, ' * 600}b]}}\n",
            5,
            3,
            "when: all `when` together have more than 1,000 values",
            id="conditions",
        ),
        pytest.param(
            f"version: 1\nprofiles:\n- when:\n    a: b\n    robot: [spot, '{'*a' * 17}']\n",
            5,
            5,
            "when.robot: a glob with 17 `*`; at most 16 are allowed",
            id="stars in a condition",
        ),
        pytest.param(
            HEAD + "topics:\n    /a: {max_gap: 100000d}\n",
            4,
            10,
            "max_gap: a duration may be at most 146.1 years",
            id="duration",
        ),
        pytest.param(HEAD + "reference: ' '\n", 3, 3, "reference: write a file, a topic such as /odom, or", id="blank"),
        pytest.param(HEAD + "reference: tf:map\n", 3, 3, "transforms are named like tf:map->base_link", id="one frame"),
        pytest.param(HEAD + "reference: nuc.mcap:tf:->a\n", 3, 3, "transforms are named like", id="in a recording"),
        pytest.param(HEAD + "reference: [/odom]\n", 3, 3, "reference: it must be text", id="several references"),
        pytest.param(
            HEAD + f"reference: {'a' * 1025}\n",
            3,
            3,
            "reference: it has more than 1024 characters",
            id="long reference",
        ),
        pytest.param("version: 1\nreference: /odom\nprofiles:\n- {}\n", 2, 1, "no such field", id="of no profile"),
    ],
)
def test_an_error_has_line_column_and_what_is_allowed(text: str, line: int, column: int, reason: str) -> None:
    error = _invalid(text)
    assert reason in error.reason
    assert (error.line, error.column) == (line, column), error


def test_the_first_of_several_errors_is_reported() -> None:
    text = HEAD + "topics:\n    /a: {rate: 1}\n    /b: {rte: 1}\n  images:\n    /c: {samples: 0}\n"
    assert (_invalid(text).line, _invalid(text).column) == (5, 10)


def test_a_file_that_is_too_large_is_refused_before_it_is_parsed() -> None:
    error = _invalid("#" * (MAX_CHECKS_CHARACTERS + 1))
    assert error.reason == "it has more than 200,000 characters"


def test_too_many_rules_are_refused() -> None:
    text = HEAD + "topics:\n" + "".join(f"    /t{number}: {{}}\n" for number in range(1001))
    assert "there are more than 1000" in _invalid(text).reason


@pytest.mark.parametrize(
    ("when", "metadata", "applies"),
    [
        ("{robot: anymal-d}", {"robot": "anymal-d"}, True),
        ("{robot: anymal-*}", {"robot": "anymal-d"}, True),
        ("{robot: anymal-*}", {"robot": "spot"}, False),
        ("{robot: anymal-*}", {}, False),
        ("{robot: [spot, anymal-*]}", {"robot": "spot"}, True),
        ("{robot: spot, night: true}", {"robot": "spot", "night": True}, True),
        ("{robot: spot, night: true}", {"robot": "spot", "night": 1}, False),
        ("{sensors: lidar}", {"sensors": ["camera", "lidar"]}, True),
        ("{mass: 50}", {"mass": 50.0}, True),
        ("{}", {"robot": "spot"}, True),
    ],
)
def test_when_chooses_by_metadata(when: str, metadata: dict[str, Any], applies: bool) -> None:
    document = read_checks(f"{HEAD}when: {when}\n")
    assert bool(choose_profiles(document, metadata).applied) is applies


REFERENCES = """
version: 1
profiles:
- {name: rules only}
- {name: vicon, when: {place: vicon-*}, reference: " /vicon/pose "}
- {name: field, when: {gnss: rtk}, reference: "nuc/*:tf:/map->/antenna"}
- {name: others, reference: "truth_*.tum"}
"""


@pytest.mark.parametrize(
    ("metadata", "reference"),
    [
        ({"place": "vicon-hall", "gnss": "rtk"}, "/vicon/pose"),
        ({"gnss": "rtk"}, "nuc/*:tf:/map->/antenna"),
        ({}, "truth_*.tum"),
        ({"place": "vicon-hall", "reference": " /odom "}, "/odom"),
        ({"gnss": "rtk", "reference": " "}, "nuc/*:tf:/map->/antenna"),
        ({"gnss": "rtk", "reference": None}, "nuc/*:tf:/map->/antenna"),
        ({"reference": 7}, "7"),
    ],
)
def test_the_reference_is_that_of_the_mission_or_of_the_first_profile_with_one(
    metadata: dict[str, Any], reference: str
) -> None:
    assert reference_of(read_checks(REFERENCES), metadata) == reference


def test_without_rules_only_the_mission_names_a_reference() -> None:
    assert reference_of(None, {"reference": "/odom"}) == "/odom"
    assert reference_of(None, {"robot": "spot"}) is None
    assert (
        reference_of(read_checks(f"{HEAD}{{when: {{robot: anymal}}, reference: /odom}}\n"), {"robot": "spot"}) is None
    )


def value_matches(value: Any, expected: Any) -> bool:
    return MatchedMetadata({"field": value}).has("field", expected)


def test_globs_of_conditions_are_compared_with_short_texts_only() -> None:
    longest, longer = "a" * MAX_MATCHED_CHARACTERS, "a" * (MAX_MATCHED_CHARACTERS + 1)
    assert value_matches(longest, "a*")
    assert not value_matches(longer, "a*")
    assert value_matches(longer, longer)
    assert value_matches([longer, "abc"], "ab*")
    assert value_matches([*(str(number) for number in range(50)), "lidar"], "li*")
    assert not value_matches([*(str(number) for number in range(200)), "lidar"], "li*")
    assert value_matches([*(str(number) for number in range(200)), "lidar"], ["camera", "lidar"])


def test_lists_are_compared_without_comparing_each_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    compared: list[str] = []
    monkeypatch.setattr("kleinkram.checks.globs.matches", lambda text, _glob: compared.append(text))
    choices = [*(f"spot-{number}" for number in range(900)), *(f"anymal-{number}-*" for number in range(100))]
    assert not value_matches([f"robot-{number}" for number in range(10_000)], choices)
    assert len(compared) <= 100 * 100


def test_each_condition_is_evaluated_once_for_a_mission(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluated: list[object] = []
    has = MatchedMetadata.has

    def note(mission: MatchedMetadata, name: str, expected: Any) -> bool:
        evaluated.append(expected)
        return has(mission, name, expected)

    monkeypatch.setattr(MatchedMetadata, "has", note)
    document = read_checks(f"{HEAD}when: {{robot: a}}\n- {{name: b, when: {{robot: b}}}}\n")
    results = evaluate_index(document, MissionFacts((), (), (), metadata={"robot": "b"}))
    assert evaluated == ["a", "b"]
    assert results.profiles_applied == ("b",)
    assert [one.reason for one in results.profiles_left_out] == ["robot is b; it must be a"]


@pytest.mark.parametrize(
    ("value", "expected", "is_match"),
    [
        (1, True, False),
        ([1, [2.0]], 2, True),
        (None, None, True),
        ([], ["a"], False),
        ({"a": [1]}, {"a": [1.0]}, True),
        ({"a": 1}, {"a": True}, False),
        ("a[1]", "a[1]", False),
    ],
)
def test_values_that_are_no_texts_are_equal(value: Any, expected: Any, is_match: bool) -> None:
    assert value_matches(value, expected) is is_match


def test_the_schema_allows_one_rule_or_several_and_refuses_unknown_keys() -> None:
    schema: Any = json_schema()
    assert json.loads(json.dumps(schema)) == schema
    assert schema["$id"] == "urn:kleinkram:checks:1"
    profile = schema["$defs"]["Profile"]
    assert profile["additionalProperties"] is False
    assert set(profile["properties"]) == set(Profile.model_fields)
    assert profile["properties"]["reference"]["anyOf"][0] == {"maxLength": 1024, "type": "string"}
    rules = profile["properties"]["topics"]["additionalProperties"]["anyOf"]
    assert rules[0] == {"$ref": "#/$defs/TopicRule"}
    assert rules[1]["items"] == {"$ref": "#/$defs/TopicRule"}
    assert schema["$defs"]["ImageRule"]["properties"]["max_frozen"]["default"] == "2s"


def test_every_field_of_a_rule_is_described_for_editors() -> None:
    schema: Any = json_schema()
    undescribed = [
        f"{name}.{field}"
        for name, model in schema["$defs"].items()
        if name.endswith("Rule")
        for field, its_schema in model["properties"].items()
        if field != "severity" and "description" not in its_schema
    ]
    assert undescribed == []


def test_the_schema_in_the_docs_is_the_one_of_the_models() -> None:
    path = Path(__file__).parents[3] / "docs" / "reference" / "checks.schema.json"
    assert json.loads(path.read_text(encoding="utf-8")) == json_schema()


def test_the_example_of_a_legged_robot_is_valid() -> None:
    path = Path(__file__).parents[3] / "examples" / "checks" / "legged-robot.yaml"
    (profile,) = read_checks(path.read_text(encoding="utf-8")).profiles
    sections = [name for name, rules in profile if isinstance(rules, dict) and rules and name != "when"]
    assert set(sections) == set(Profile.model_fields) - {"name", "when", "reference"}
    cameras = [name for name in profile.topics if name.startswith("/camera/") and "*" not in name]
    assert (len(profile.recordings), len(cameras)) == (4, 12)
