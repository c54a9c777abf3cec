from hypothesis import given
from hypothesis import strategies as st

from kleinkram.server.blobs.fitting import fit


@given(st.text())
def test_whatever_a_file_says_fits_into_the_database(text: str) -> None:
    fitted = fit(text)
    assert "\0" not in fitted
    assert len(fitted.encode()) <= 1000


def test_plain_text_stays() -> None:
    assert fit("/imu/data") == "/imu/data"
    assert fit(None) is None
    assert fit("a\0b") == "a\\0b"
    assert fit("a\udcffb") == "a\\udcffb"


def test_long_texts_that_differ_still_do() -> None:
    first, second = fit("x" * 5000 + "1"), fit("x" * 5000 + "2")
    assert first != second
    assert first.startswith("x" * 900)
