"""The verdict of a mission, of checks from the index, reports of uploaders, actions, and what people accepted."""

import itertools
import uuid

import pytest

from kleinkram.checks.outcomes import LEFT_OUT
from kleinkram.contract.checks import MAX_CHECKS, Check, CheckSource, CheckStatus, MissionCheck, Verdict
from kleinkram.server.checks.combine import (
    Acceptance,
    CombinedChecks,
    Sources,
    UploaderReport,
    combine,
    is_content_outdated,
    reads_content,
)

OK, WARNING, ERROR = CheckStatus.ok, CheckStatus.warning, CheckStatus.error
NOT_MADE, NEEDS_CONTENT = CheckStatus.not_made, CheckStatus.needs_content
_ACCEPTED_ID = uuid.UUID(int=1)


def made(name: str, status: CheckStatus, topic: str | None = None) -> Check:
    return Check(name=name, status=status, message="measured", topic=topic)


def of_action(name: str, status: CheckStatus, topic: str | None = None) -> MissionCheck:
    check = made(name, status, topic)
    return MissionCheck.model_construct(**check.__dict__, source=CheckSource.action, action="verify")


def report(*checks: Check, present: bool = True, content: bool = True, person: int = 1) -> UploaderReport:
    return UploaderReport(uuid.UUID(int=person), checks, is_by_present_rules=present, has_content=content)


def accepted(check: str, topic: str | None = None) -> Acceptance:
    return Acceptance(_ACCEPTED_ID, check, topic)


def outcomes(combined: CombinedChecks) -> list[tuple[str, CheckStatus, CheckSource]]:
    return [(check.name, check.status, check.source) for check in combined.checks]


@pytest.mark.parametrize(
    ("statuses", "verdict"),
    [
        ((), Verdict.unchecked),
        ((NEEDS_CONTENT,), Verdict.unchecked),
        ((OK, NEEDS_CONTENT), Verdict.unchecked),
        ((OK, WARNING), Verdict.warnings),
        ((OK, WARNING, NEEDS_CONTENT), Verdict.warnings),
        ((NOT_MADE, NEEDS_CONTENT), Verdict.warnings),
        ((ERROR, NEEDS_CONTENT), Verdict.bad),
        ((OK, NOT_MADE), Verdict.warnings),
        ((NOT_MADE,), Verdict.warnings),
        ((OK, WARNING, NOT_MADE, ERROR), Verdict.bad),
    ],
)
def test_the_worst_check_from_the_index_decides(statuses: tuple[CheckStatus, ...], verdict: Verdict) -> None:
    combined = combine(Sources(index=[made("topic.rate", status) for status in statuses]))
    assert combined.verdict is verdict
    assert sum(combined.counts.values()) == len(statuses)
    assert combined.failed == (["topic.rate"] if {WARNING, ERROR} & {*statuses} else [])


@pytest.mark.parametrize(
    ("index", "content", "action"), [*itertools.product((OK, WARNING, ERROR), (OK, WARNING, ERROR), (OK, ERROR))]
)
def test_the_worst_of_all_sources_decides(index: CheckStatus, content: CheckStatus, action: CheckStatus) -> None:
    sources = Sources(
        index=[made("topic.rate", index), made("image.black", NEEDS_CONTENT)],
        reports=[report(made("image.black", content))],
        actions=[of_action("slam.drift", action)],
    )
    combined = combine(sources)
    made_of = {index, content, action}
    assert combined.verdict is (
        Verdict.bad if ERROR in made_of else Verdict.warnings if WARNING in made_of else Verdict.good
    )
    assert combined.statuses == {"topic.rate": index, "image.black": content, "slam.drift": action}
    order = [OK, WARNING, ERROR]
    assert [check.status for check in combined.checks] == sorted((index, content, action), key=order.index)[::-1]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("topic.rate", False),
        ("file.size", False),
        ("recording.coverage", False),
        ("checks.file", False),
        ("clock.jump", False),
        ("clock.stamp_jump", True),
        ("image.black", True),
        ("value.nan", True),
    ],
)
def test_checks_that_read_messages_are_known_by_name(name: str, expected: bool) -> None:
    assert reads_content(name) is expected


def test_of_a_report_only_checks_of_content_count() -> None:
    # Else an uploader's old index would outweigh what the server sees.
    sources = Sources(
        index=[made("topic.rate", ERROR), made("clock.jump", OK), made("image.black", NEEDS_CONTENT)],
        reports=[report(made("topic.rate", OK), made("clock.jump", ERROR), made("image.black", WARNING))],
    )
    assert outcomes(combine(sources)) == [
        ("topic.rate", ERROR, CheckSource.server),
        ("image.black", WARNING, CheckSource.report),
        ("clock.jump", OK, CheckSource.server),
    ]


def test_of_each_person_the_latest_report_of_content_counts_alone() -> None:
    newer, older = report(made("image.black", OK)), report(made("image.black", ERROR), made("imu.tilt", ERROR))
    index = [made("image.black", NEEDS_CONTENT)]
    assert outcomes(combine(Sources(index=index, reports=[newer, older]))) == [("image.black", OK, CheckSource.report)]
    assert (
        combine(Sources(index=index, reports=[newer, report(made("image.black", OK)), older])).verdict is Verdict.good
    )
    # A later report of the index alone does not hide what was found in the content.
    of_index = report(made("topic.rate", OK), content=False)
    assert combine(Sources(index=index, reports=[of_index, older])).verdict is Verdict.bad


@pytest.mark.parametrize("content", [True, False])
def test_a_report_by_other_rules_does_not_count(content: bool) -> None:
    old = report(made("image.black", ERROR), present=False, content=content)
    index = [made("topic.rate", OK), made("image.black", NEEDS_CONTENT)]
    sources = Sources(index=index, reports=[old])
    assert combine(sources).verdict is Verdict.unchecked
    assert combine(Sources(reports=[old])).verdict is Verdict.unchecked
    assert is_content_outdated(sources) is content
    assert not is_content_outdated(Sources(index=index, reports=[old, report(made("image.black", OK))]))
    assert not is_content_outdated(Sources(index=index[:1], reports=[old])), "nothing asks for content any more"


def test_what_a_report_lacks_of_the_checks_of_content_is_still_to_be_made() -> None:
    # The profiles that apply to a mission may have changed with its metadata, not with the rules.
    index = [made("image.black", NEEDS_CONTENT, "/left"), made("imu.tilt", NEEDS_CONTENT)]
    sources = Sources(index=index, reports=[report(made("image.black", OK, "/left"))])
    assert is_content_outdated(sources)
    assert outcomes(combine(sources)) == [
        ("imu.tilt", NEEDS_CONTENT, CheckSource.server),
        ("image.black", OK, CheckSource.report),
    ]
    too_long = report(made("image.black", OK, "/left"), made(LEFT_OUT, OK))
    assert not is_content_outdated(Sources(index=index, reports=[too_long])), "it may have been left out of the list"


@pytest.mark.parametrize("index", [None, [made("image.black", NEEDS_CONTENT)]])
def test_a_report_does_not_overrule_what_another_person_found(index: list[Check] | None) -> None:
    bad = report(made("image.black", ERROR, "/left"), made("image.black", OK, "/right"), person=1)
    good = report(made("image.black", OK, "/left"), made("image.black", WARNING, "/right"), person=2)
    for reports in ([bad, good], [good, bad], [good, good, bad]):
        combined = combine(Sources(index=index, reports=reports))
        assert combined.verdict is Verdict.bad
        statuses = [(check.topic, check.status) for check in combined.checks]
        assert statuses == [("/left", ERROR), ("/right", WARNING)]


def test_topics_that_a_report_left_out_keep_a_mission_from_being_good() -> None:
    reports = [report(made("image.black", OK), made(LEFT_OUT, NOT_MADE))]
    combined = combine(Sources(index=[made("image.black", NEEDS_CONTENT)], reports=reports))
    assert (combined.verdict, combined.failed) == (Verdict.warnings, [])


def test_a_check_that_waits_for_one_topic_has_not_passed() -> None:
    index = [made("clock.stamp_jump", OK, "/imu"), made("clock.stamp_jump", NEEDS_CONTENT, "/lidar")]
    assert combine(Sources(index=index)).statuses == {"clock.stamp_jump": NEEDS_CONTENT}


def test_without_rules_of_the_project_a_whole_report_counts() -> None:
    reports = [report(made("topic.rate", ERROR), content=False), report(made("topic.rate", OK), made("imu.tilt", OK))]
    assert outcomes(combine(Sources(reports=reports))) == [
        ("topic.rate", OK, CheckSource.report),
        ("imu.tilt", OK, CheckSource.report),
    ]
    assert combine(Sources(reports=reports[:1])).verdict is Verdict.bad


@pytest.mark.parametrize(
    ("acceptance", "verdict", "failed", "counts"),
    [
        (accepted("topic.gap", "/imu"), Verdict.bad, ["topic.gap"], {"accepted": 1, "error": 1, "ok": 1}),
        (accepted("topic.gap"), Verdict.good, [], {"accepted": 2, "ok": 1}),
        (accepted("topic.gap", "/tf"), Verdict.bad, ["topic.gap"], {"error": 2, "ok": 1}),
        (accepted("topic.rate"), Verdict.bad, ["topic.gap"], {"error": 2, "ok": 1}),
    ],
)
def test_an_acceptance_covers_its_check_on_its_topic(
    acceptance: Acceptance, verdict: Verdict, failed: list[str], counts: dict[str, int]
) -> None:
    index = [made("topic.gap", ERROR, "/imu"), made("topic.gap", ERROR, "/lidar"), made("topic.rate", OK, "/imu")]
    combined = combine(Sources(index=index, acceptances=[acceptance]))
    assert (combined.verdict, combined.failed, combined.counts) == (verdict, failed, counts)
    # What failed stays in sight.
    assert [check.status for check in combined.checks] == [ERROR, ERROR, OK]


@pytest.mark.parametrize("status", [WARNING, ERROR, NOT_MADE])
def test_checks_of_every_source_can_be_accepted(status: CheckStatus) -> None:
    sources = Sources(
        index=[made("topic.rate", status), made("image.black", NEEDS_CONTENT)],
        reports=[report(made("image.black", status))],
        actions=[of_action("slam.drift", status)],
        acceptances=[accepted("topic.rate"), accepted("image.black"), accepted("slam.drift")],
    )
    combined = combine(sources)
    assert (combined.verdict, combined.counts, combined.failed) == (Verdict.good, {"accepted": 3}, [])
    assert {*combined.statuses.values()} == {OK}
    assert {check.acceptance_id for check in combined.checks} == {_ACCEPTED_ID}


@pytest.mark.parametrize(
    ("status", "running", "outdated", "verdict"),
    [
        (OK, True, False, Verdict.running),
        (OK, False, True, Verdict.outdated),
        (OK, True, True, Verdict.running),
        (WARNING, False, True, Verdict.outdated),
        (WARNING, True, False, Verdict.running),
        (ERROR, True, True, Verdict.bad),
        (ERROR, False, True, Verdict.bad),
    ],
)
def test_an_error_counts_at_once_and_nothing_is_good_before_all_is_made(
    status: CheckStatus, running: bool, outdated: bool, verdict: Verdict
) -> None:
    sources = Sources(index=[made("topic.rate", status)], is_running=running, is_outdated=outdated)
    assert combine(sources).verdict is verdict


def test_an_accepted_error_leaves_a_mission_outdated() -> None:
    sources = Sources(index=[made("topic.rate", ERROR)], acceptances=[accepted("topic.rate")], is_outdated=True)
    assert combine(sources).verdict is Verdict.outdated


def test_too_many_checks_are_counted_and_the_worst_are_listed() -> None:
    index = [made("topic.rate", OK, f"/t{number}") for number in range(MAX_CHECKS)] + [made("topic.gap", ERROR)]
    combined = combine(Sources(index=index))
    assert len(combined.checks) == MAX_CHECKS
    assert combined.checks[0].name == "topic.gap"
    last = combined.checks[-1]
    assert (last.name, last.message) == (LEFT_OUT, "2 more checks are not listed")
    assert combined.counts == {"ok": MAX_CHECKS, "error": 1}
    assert len(combine(Sources(index=index[1:])).checks) == MAX_CHECKS
    assert combine(Sources(index=index[1:])).checks[-1].name == "topic.rate"
