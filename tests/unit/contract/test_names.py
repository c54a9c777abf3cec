import pytest
from hypothesis import given
from hypothesis import strategies as st

from kleinkram.contract.names import check_file_path, check_label, check_name, is_id, name_key

_UUID = "0f0e0d0c-0b0a-4090-8070-605040302010"


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("", "empty"),
        (" day", "space"),
        ("two\nlines", "U\\+000A at position 3"),
        ("nul\0", "U\\+0000"),
        ("right\u202eleft", "U\\+202E"),
        ("x" * 300, "300 characters"),
        ("..", "folder reference"),
        ("a/b", "contains /"),
        ("day*", "contains \\*"),
        (_UUID, "has the form of an id"),
    ],
)
def test_invalid_names_are_refused_with_a_reason(name: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        check_name(name)


@pytest.mark.parametrize("name", ["Jungfraujoch 1", "día-3", "🤖 run", "テスト", "a" * 128])
def test_printable_names_are_unchanged(name: str) -> None:
    assert check_name(name) == name


def test_names_that_differ_by_case_or_unicode_form_are_the_same() -> None:
    assert name_key("Zürich") == name_key("ZU\u0308RICH")
    assert name_key("Straße") == name_key("STRASSE")
    assert name_key("day 1") != name_key("day 2")


@given(st.text())
def test_name_keys_are_idempotent(text: str) -> None:
    assert name_key(name_key(text)) == name_key(text)


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("/etc/passwd", "relative"),
        ("a/../b", "part '..'"),
        ("a//b", "part ''"),
        ("./a", "part '.'"),
        ("a\\b", "backslash"),
        ("a/", "relative"),
        ("nul\0", "U\\+0000"),
        ("bad\udcff", "U\\+DCFF"),
        ("x" * 256, "256 bytes"),
        ("a/" * 600 + "b", "1201 characters"),
    ],
)
def test_invalid_paths_are_refused(path: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        check_file_path(path)


@given(st.text(min_size=1))
def test_accepted_paths_stay_inside_the_mission(text: str) -> None:
    try:
        path = check_file_path(text)
    except ValueError:
        return
    assert not path.startswith("/")
    assert not set(path.split("/")) & {"", ".", ".."}


def test_labels_contain_no_commas() -> None:
    assert check_label("night run") == "night run"
    with pytest.raises(ValueError, match="comma"):
        check_label("a,b")


def test_an_id_is_distinguished_from_a_name() -> None:
    assert is_id(_UUID)
    assert not is_id("day-1")
