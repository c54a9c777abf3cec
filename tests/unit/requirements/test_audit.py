"""Known vulnerabilities in dependencies fail the check."""

import datetime

import pytest
from requirements.audit import Report, failures, read_accepted, unaudited

from requirements import audit

TODAY = datetime.date(2026, 5, 1)
HOLE = {"id": "PYSEC-1", "aliases": ["CVE-2026-1"], "fix_versions": ["2.0"]}
REPORT = Report.model_validate(
    {"dependencies": [{"name": "a", "version": "1.0", "vulns": [HOLE]}, {"name": "b", "version": "1.0", "vulns": []}]}
)


def test_a_vulnerability_is_named_with_its_fix() -> None:
    assert failures(REPORT, [], TODAY) == ["a 1.0: PYSEC-1 (mended in: 2.0)"]


@pytest.mark.parametrize("name", ["PYSEC-1", "CVE-2026-1"])
def test_an_accepted_vulnerability_passes_until_its_date(name: str) -> None:
    accepted = read_accepted(f"# comment\n\n{name} a 2026-05-01 we never call it\n")
    assert failures(REPORT, accepted, TODAY) == []
    late = failures(REPORT, accepted, TODAY + datetime.timedelta(days=1))
    assert late == [f"accepted.txt: {name} of a was accepted until 2026-05-01", "a 1.0: PYSEC-1 (mended in: 2.0)"]


def test_another_package_s_entry_does_not_count() -> None:
    assert failures(REPORT, read_accepted("PYSEC-1 b 2026-05-01 x"), TODAY) != []


@pytest.mark.parametrize("line", ["PYSEC-1 a", "PYSEC-1 a soon x", "PYSEC-1 a 2026-05-01"])
def test_an_entry_without_day_or_reason_is_refused(line: str) -> None:
    with pytest.raises(ValueError):
        read_accepted(line)


def test_our_own_entries_are_readable() -> None:
    read_accepted((audit._HERE / "accepted.txt").read_text(encoding="utf-8"))


def test_packages_unknown_to_the_service_are_reported_as_not_audited() -> None:
    report = Report.model_validate({"dependencies": [{"name": "a", "skip_reason": "not found"}, {"name": "b"}]})
    assert unaudited(report) == ["a"]


@pytest.mark.parametrize(("required", "code"), [("", 0), ("1", 1)])
def test_an_unreachable_service_is_reported_and_fails_only_where_required(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], required: str, code: int
) -> None:
    monkeypatch.setenv("KLEINKRAM_REQUIRE_AUDIT", required)
    monkeypatch.setattr(audit, "_SERVICES", ())
    assert audit.main() == code
    assert "NOT AUDITED: no service of advisories answers from here" in capsys.readouterr().err
