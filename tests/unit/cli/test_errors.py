"""Every error has an exit code that scripts can rely on."""

import pytest

from kleinkram.cli.errors import EXIT_CODES, ExitCode, Interrupted, NotConfirmed, exit_code_of, explain
from kleinkram.client import errors as local
from kleinkram.client.errors import ClientError, remember_request
from kleinkram.contract.errors import ERRORS, FieldProblem, KleinkramError, MetadataInvalid, NotFound


def test_every_failure_has_an_exit_code() -> None:
    ours = {
        cls
        for cls in vars(local).values()
        if isinstance(cls, type) and issubclass(cls, ClientError) and cls is not ClientError
    }
    assert set(EXIT_CODES) == {*ERRORS.values(), *ours, Interrupted, NotConfirmed}
    assert 0 not in {int(code) for code in EXIT_CODES.values()}


def test_numbers_never_change() -> None:
    assert {code.name: code.value for code in ExitCode} == {
        "server_failed": 1,
        "usage": 2,
        "not_found": 3,
        "not_allowed": 4,
        "conflict": 5,
        "metadata": 6,
        "unreachable": 7,
        "local_file": 8,
        "bytes_differ": 9,
        "several": 10,
        "destination": 11,
        "timed_out": 12,
        "no_room": 13,
        "run_failed": 14,
        "verdict_bad": 15,
        "not_good": 16,
        "interrupted": 130,
    }


def test_failures_with_one_exit_code_keep_it() -> None:
    changed = local.FileChanged(path="a", reason="b")
    left_out = local.StillRecording(path="a", reason="b")
    gone: KleinkramError = NotFound(resource_type="file", ref="x")
    assert exit_code_of([]) == 0
    assert exit_code_of([left_out]) == ExitCode.local_file, "a file that was left out is not where it should be"
    assert exit_code_of([changed, changed, left_out]) == ExitCode.local_file
    assert exit_code_of([changed, gone]) == ExitCode.several


def test_a_failure_is_printed_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    assert explain(remember_request(NotFound(resource_type="file", ref="evil\x1b[2J"), "abc")) == 3
    output = capsys.readouterr()
    assert output.out == ""
    assert "Request id: abc" in output.err
    assert "\x1b" not in output.err


def test_all_problems_are_printed_with_their_place(capsys: pytest.CaptureFixture[str]) -> None:
    problems = [
        FieldProblem(field="robot", message="is missing"),
        FieldProblem(field="t", message="is not a number", line=2, column=4),
    ]
    assert explain(MetadataInvalid(problems)) == ExitCode.metadata
    output = capsys.readouterr().err
    assert "robot: is missing" in output
    assert "t (line 2, column 4): is not a number" in output


def test_unexpected_errors_are_not_handled() -> None:
    assert explain(KeyError("x")) is None
