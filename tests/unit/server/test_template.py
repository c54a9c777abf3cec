"""The YAML template of metadata parses and repeats the values of the last mission."""

from hypothesis import given
from hypothesis import strategies as st

from kleinkram.contract.metadata import FieldType, Metadata, MetadataField, MetadataFields, Undeclared
from kleinkram.server.missions.metadata import carried_over, defaults, read_metadata, satisfying, write_template

_TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), max_size=40)
_SCALAR = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63) + 1, 2**63 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | _TEXT
    | st.sampled_from(["null", "~", "yes", "true", "1e3", "- a", "a: b", "#", "a #b", "2024-05-31", "0x1F", ""])
)
_VALUE = st.recursive(
    _SCALAR,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_TEXT, inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(_TEXT, _VALUE, max_size=5), _TEXT, _TEXT)
def test_the_template_repeats_the_values_of_the_mission(metadata: Metadata, project: str, mission: str) -> None:
    text = write_template(MetadataFields(), {}, metadata, project=project, source=mission)
    assert read_metadata(text).value == {}, "nothing is said before somebody says it"
    _, _, others = text.partition("# Not declared by the project")
    lines = [line.removeprefix("# ") for line in others.split("\n")[1:]]
    assert read_metadata("\n".join(lines)).value == metadata


@given(_TEXT, _TEXT, st.sampled_from([kind for kind in FieldType if kind is not FieldType.choice]))
def test_descriptions_and_units_break_nothing(description: str, unit: str, kind: FieldType) -> None:
    field = MetadataField(
        name="a", type=kind, description=description, unit=unit[:32] if kind is FieldType.number else None
    )
    fields = MetadataFields(fields=[field], undeclared=Undeclared.refuse)
    text = write_template(fields, defaults(fields), carried_over(fields, {"a": "x", "b": 1}), project="p", source="m")
    assert satisfying(read_metadata(text), fields) == {}


def test_dates_weather_and_operator_are_not_carried_over() -> None:
    kinds = {"robot": FieldType.string, "test_day": FieldType.date, "weatherNote": FieldType.string}
    fields = MetadataFields(fields=[MetadataField(name=name, type=kind) for name, kind in kinds.items()])
    last: Metadata = {"robot": "spot", "test_day": "2026-01-01", "weatherNote": "rain", "operator": "ada"}
    last |= {"first_pilot": "bob", "recorded": "2026-01-01T08:00:00Z", "site": "Zurich", "holiday": "no", "timeout": 3}
    assert carried_over(fields, last) == {"robot": "spot", "site": "Zurich", "holiday": "no", "timeout": 3}
