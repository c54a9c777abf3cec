from hypothesis import given
from hypothesis import strategies as st

from kleinkram.server.db import fit_text


@given(st.text())
def test_any_content_of_a_file_fits_into_the_database(text: str) -> None:
    fitted = fit_text(text)
    assert "\0" not in fitted
    assert len(fitted.encode()) <= 1000


def test_plain_text_stays() -> None:
    assert fit_text("/imu/data") == "/imu/data"
    assert fit_text(None) is None
    assert fit_text("a\0b") == "a\\0b"
    assert fit_text("a\udcffb") == "a\\udcffb"


def test_long_texts_that_differ_still_do() -> None:
    first, second = fit_text("x" * 5000 + "1"), fit_text("x" * 5000 + "2")
    assert first != second
    assert first.startswith("x" * 900)
