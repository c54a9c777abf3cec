"""Every error sentence names what failed, where, and what to do."""

from dataclasses import fields

import pytest

from kleinkram.client import errors
from kleinkram.client._http import query_of, reason_of
from kleinkram.client._resources import checked
from kleinkram.client.errors import ClientError, InvalidInput, remember_request, request_id_of
from kleinkram.client.transfer.store import StoreAnswer, meaning
from kleinkram.contract.errors import InternalError, NotFound
from kleinkram.contract.files import BlobState, FileFilter
from kleinkram.contract.projects import ProjectCreate

CLASSES = [cls for cls in vars(errors).values() if isinstance(cls, type) and issubclass(cls, ClientError)]


@pytest.mark.parametrize("cls", [cls for cls in CLASSES if cls is not ClientError])
def test_a_sentence_contains_all_fields(cls: type[ClientError]) -> None:
    values = {field.name: 7.5 if field.name == "seconds" else f"<{field.name}>" for field in fields(cls)}
    sentence = str(cls(**values))
    assert all(str(value) in sentence for value in values.values())
    # The reason of this one is a sentence of its own, or a question.
    assert sentence.endswith("<reason>" if cls is errors.ChecksInvalid else (".", "?"))
    assert "{" not in sentence


def test_the_request_id_stays_with_the_error() -> None:
    error = remember_request(NotFound(resource_type="file", ref="x"), "abc")
    assert request_id_of(error) == "abc"
    assert str(error) == "There is no file 'x' that you may see."
    assert request_id_of(remember_request(InternalError(request_id="unknown"), "abc")) == "abc"
    assert request_id_of(remember_request(InternalError(request_id="theirs"), "abc")) == "theirs"
    assert request_id_of(ValueError()) is None


def test_a_wrong_name_is_refused_before_it_is_sent() -> None:
    with pytest.raises(InvalidInput, match=r"name.*control character"):
        checked(ProjectCreate, "The project", name="a\nb")


def test_a_filter_contains_only_the_passed_arguments() -> None:
    query = query_of(FileFilter(topic=["/a", "/b"], state=[BlobState.lost]), limit=5, cursor=None, count=True)
    assert query == [("topic", "/a"), ("topic", "/b"), ("state", "lost"), ("limit", "5"), ("count", "true")]


def test_reasons_are_short_and_contain_no_address() -> None:
    error = ConnectionError("outer")
    error.__cause__ = ConnectionRefusedError(111, "Connection refused")
    assert reason_of(error) == "Connection refused"
    assert reason_of(TimeoutError()) == "it took too long"


@pytest.mark.parametrize(
    ("status", "code", "answer"),
    [
        (403, "AccessDenied", StoreAnswer.sign_again),
        (404, "NoSuchUpload", StoreAnswer.gone),
        (404, "NoSuchKey", StoreAnswer.gone),
        (404, "NoSuchBucket", StoreAnswer.try_again),
        (404, "", StoreAnswer.try_again),
        (410, "", StoreAnswer.try_again),
        (400, "BadDigest", StoreAnswer.refused),
        (400, "RequestTimeout", StoreAnswer.try_again),
        (408, "", StoreAnswer.try_again),
        (429, "", StoreAnswer.try_again),
        (500, "InternalError", StoreAnswer.try_again),
        (501, "NotImplemented", StoreAnswer.refused),
        (503, "SlowDown", StoreAnswer.try_again),
    ],
)
def test_errors_of_the_store_are_classified(status: int, code: str, answer: StoreAnswer) -> None:
    assert meaning(status, code) is answer
