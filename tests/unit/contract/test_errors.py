import dataclasses

import pytest

from kleinkram.contract.errors import (
    ERRORS,
    ErrorCode,
    FieldProblem,
    FileExists,
    InternalError,
    KleinkramError,
    MetadataInvalid,
)
from kleinkram.contract.problems import ProblemDocument, from_problem, to_problem

_VALUES: dict[str, object] = {
    "str": "text",
    "int": 7,
    "float": 2.5,
    "str | None": "text",
    "int | None": 8,
    "list[str]": ["a/b (1)", "a/c (2)"],
    str(list[FieldProblem]): [FieldProblem(field="robot", message="is missing", line=3)],
}


def _example(cls: type[KleinkramError]) -> KleinkramError:
    return cls(
        **{
            field.name: _VALUES[str(field.type)] if isinstance(field.type, str) else _of(field.type)
            for field in dataclasses.fields(cls)
        }
    )


def _of(kind: object) -> object:
    name = getattr(kind, "__name__", str(kind))
    return _VALUES.get(name, _VALUES.get(str(kind), "text"))


def test_every_code_has_one_class() -> None:
    assert set(ERRORS) == set(ErrorCode)


@pytest.mark.parametrize("code", ErrorCode)
def test_errors_survive_serialisation(code: ErrorCode) -> None:
    error = _example(ERRORS[code])
    document = to_problem(error, "text").model_dump_json()
    back = from_problem(ProblemDocument.model_validate_json(document))
    assert type(back) is type(error)
    assert back.sentence() == error.sentence()
    assert "{" not in error.sentence()


def test_the_sentence_names_both_hashes() -> None:
    error = FileExists(path="run.mcap", existing_sha256="aa", sent_sha256="bb", existing_file_id="1")
    assert "aa" in str(error)
    assert "bb" in str(error)


def test_all_problems_are_named_at_once() -> None:
    problems = [FieldProblem(field="robot", message="is missing"), FieldProblem(field="site", message="is unknown")]
    sentence = str(MetadataInvalid(problems=problems))
    assert "robot: is missing" in sentence
    assert "site: is unknown" in sentence


def test_an_error_with_missing_fields_becomes_internal_error() -> None:
    document = to_problem(FileExists(path="a", existing_sha256=None, sent_sha256=None, existing_file_id="1"), "req-9")
    cut = {key: value for key, value in document.model_dump(mode="json").items() if key != "path"}
    back = from_problem(ProblemDocument.model_validate(cut))
    assert isinstance(back, InternalError)
    assert back.request_id == "req-9"
