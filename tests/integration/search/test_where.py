"""Comparisons with metadata, in lists of missions and of files."""

import pytest

from tests.integration.api_server import Api
from tests.integration.sample import Sample

MISSIONS = {
    "one": "robot: anymal\ntemperature: 9.5\nday: 2024-05-01\nindoors: true\nsite: {latitude: 47, name: Zürich}\n",
    "two": "robot: spot\ntemperature: 10\nday: 2024-05-01 14:00+02:00\nindoors: false\ntags: [rain, night, 7]\n",
    "three": "robot: '7'\ntemperature: warm\nday: 2024-06-01\nsite: 100%_real\n",
    "none": "",
}


@pytest.fixture(scope="module")
def project_id(api: Api, sample: Sample) -> str:
    made: str = api.project(fields_yaml="fields: [{name: day, type: date}]")["id"]
    for name, text in MISSIONS.items():
        sample.file(api.mission(made, name=name, metadata_yaml=text)["id"], f"{name}.mcap")
    return made


@pytest.mark.parametrize(
    ("expression", "result"),
    [
        ("robot=anymal", "one"),
        ("robot = anymal", "one"),
        ("robot=Anymal", ""),
        ("robot!=anymal", "three two"),
        ("robot~ANY*", "one"),
        ("robot~sp?t", "two"),
        ("robot=7", "three"),
        ('robot="7"', "three"),
        ("temperature=10", "two"),
        ("temperature=10.0", "two"),
        ("temperature>9", "one two"),
        ("temperature>9.5", "two"),
        ("temperature>=9.5", "one two"),
        ("temperature<10", "one"),
        ("temperature<=1e1", "one two"),
        ("temperature!=10", "one three"),
        ("temperature>a", "three"),
        ("day>2024-05-01", "three two"),
        ("day<2024-05-01T13:00Z", "one two"),
        ("day=2024-05-01 12:00", "two"),
        ("day>=2024-05-01", "one three two"),
        ("indoors=true", "one"),
        ("indoors!=true", "two"),
        ("site.latitude>40", "one"),
        ("site.name=Zürich", "one"),
        ("site.nowhere=1", ""),
        ("site~100%_*", "three"),
        ("site~1000_*", ""),
        ("tags=night", "two"),
        ("tags=7", "two"),
        ("tags!=night", ""),
        ("nothing=1", ""),
        ("nothing!=1", ""),
        ("robot=' OR 1=1 --", ""),
        ("robot=:x %(y)s", ""),
    ],
)
def test_comparisons_of_metadata_find_missions_and_files(
    api: Api, project_id: str, expression: str, result: str
) -> None:
    query = {"project_id": project_id, "where": expression}
    assert " ".join(mission["name"] for mission in api.all("/missions", query)) == result
    files = sorted(file["mission"]["name"] for file in api.all("/files", query))
    assert " ".join(files) == result


def test_all_comparisons_must_be_true(api: Api, project_id: str) -> None:
    query = [("project_id", project_id), ("where", "temperature>5"), ("where", "robot=spot")]
    assert [mission["name"] for mission in api.get("/missions", query).ok()["items"]] == ["two"]


@pytest.mark.parametrize(
    "expression", ["", "robot", "=anymal", "robot=", "1robot=x", "indoors>true", "a..b=1", "robot==x y", "a b=c"]
)
def test_invalid_comparisons_are_refused(api: Api, expression: str) -> None:
    for path in ("/missions", "/files", "/topics", "/stats"):
        answer = api.get(path, {"where": expression})
        if expression == "robot==x y":  # equals "=x y": odd, but a comparison
            answer.ok()
        else:
            assert answer.refused(422, "invalid_query")["expression"] == expression


@pytest.mark.parametrize("value", ["9" * 400, "1e999", "-1e-999", "0x10", "٣", "1_000", "9" * 18 + "." + "9" * 18])
def test_extreme_numbers_are_accepted(api: Api, value: str) -> None:
    for operator in ("=", "!=", "<", "~"):
        api.get("/missions", {"where": f"temperature{operator}{value}"}).ok()


@pytest.mark.parametrize("query", [{"where": "a=\x00"}, {"text": "\x00"}, {"name": "a\x00"}, {"project": "\x00"}])
def test_values_outside_the_range_of_the_database_are_refused(api: Api, query: dict[str, str]) -> None:
    api.get("/missions", query).refused(422, "invalid_request")


@pytest.mark.parametrize(
    ("sort", "result"),
    [
        ("meta.robot", ["three", "one", "two", "none"]),
        ("-meta.robot", ["two", "one", "three", "none"]),
        ("meta.temperature", ["three", "one", "two", "none"]),
        ("-meta.temperature", ["two", "one", "three", "none"]),
        ("meta.day", ["one", "two", "three", "none"]),
        ("-meta.indoors", ["one", "two"]),
        ("meta.site.latitude", ["one"]),
    ],
)
def test_a_list_is_sorted_by_metadata_page_by_page(api: Api, project_id: str, sort: str, result: list[str]) -> None:
    """Missions without the field come last in both directions, and pages neither repeat nor skip one."""
    query = {"project_id": project_id, "sort": sort, "limit": "1"}
    names = [mission["name"] for mission in api.all("/missions", query)]
    assert names[: len(result)] == result
    assert sorted(names) == sorted(MISSIONS)


@pytest.mark.parametrize("sort", ["robot", "meta.", "--meta.robot", "meta.a b", "meta.1a", "meta." + "a" * 300])
def test_an_order_that_names_no_column_is_refused(api: Api, sort: str) -> None:
    api.get("/missions", {"sort": sort}).refused(422, "invalid_request")


def test_a_cursor_of_another_order_is_refused(api: Api, project_id: str) -> None:
    query = {"project_id": project_id, "limit": "1"}
    cursor = api.get("/missions", {**query, "sort": "meta.robot"}).ok()["next"]
    for sort in ("meta.day", "-meta.robot", "name"):
        api.get("/missions", {**query, "sort": sort, "cursor": cursor}).refused(422, "invalid_cursor")
