"""Forecasts of the status, and when and what the weekly report says."""

import datetime
import uuid

import pytest

from kleinkram.contract.admin import AdminStatus, CapacityForecast, CapacityUnit, StatusItem, StatusSeverity
from kleinkram.contract.home import StoreUse
from kleinkram.contract.projects import ProjectRef
from kleinkram.server.admin.capacity import forecast, store_capacity
from kleinkram.server.admin.report import last_due_time, report_subject, report_text
from kleinkram.server.settings import Settings

NOW = datetime.datetime(2026, 5, 6, 12, tzinfo=datetime.timezone.utc)  # a Wednesday
ROBOTS = ProjectRef(id=uuid.UUID(int=1), name="Robots")


def _forecast(used: int, limit: int, per_day: float) -> datetime.datetime | None:
    return forecast(None, CapacityUnit.bytes, used=used, limit=limit, per_day=per_day, now=NOW).full_at


@pytest.mark.parametrize(
    ("used", "limit", "per_day", "days"),
    [(40, 100, 6, 10), (100, 100, 0, 0), (120, 100, 5, 0), (0, 1, 4, 0.25), (0, 0, 0, 0), (98, 100, 0.25, 8)],
)
def test_the_rate_gives_when_a_limit_is_reached(used: int, limit: int, per_day: float, days: float) -> None:
    assert _forecast(used, limit, per_day) == NOW + datetime.timedelta(days=days)


@pytest.mark.parametrize(("used", "limit", "per_day"), [(40, 100, 0), (0, 10**9, 1), (0, 10**19, 1)])
def test_what_does_not_grow_or_is_far_from_its_limit_has_no_date(used: int, limit: int, per_day: int) -> None:
    assert _forecast(used, limit, per_day) is None


def test_a_store_of_unknown_size_has_no_forecast() -> None:
    assert store_capacity(StoreUse(used_bytes=5, free_bytes=None, disk_bytes=None), 1, NOW) is None
    known = store_capacity(StoreUse(used_bytes=5, free_bytes=40, disk_bytes=100), 4, NOW)
    assert known is not None
    assert (known.used, known.full_at) == (60, NOW + datetime.timedelta(days=10)), "others use the disk, too"


@pytest.mark.parametrize(
    ("now", "due"),
    [
        ("2026-05-06T12:00", "2026-05-04T06:00"),
        ("2026-05-04T06:00", "2026-05-04T06:00"),
        ("2026-05-04T05:59", "2026-04-27T06:00"),
        ("2026-05-03T23:59", "2026-04-27T06:00"),
    ],
)
def test_a_report_is_due_on_mondays(now: str, due: str) -> None:
    at, expected = (datetime.datetime.fromisoformat(f"{text}:00+00:00") for text in (now, due))
    assert last_due_time(at) == expected


def _settings() -> Settings:
    fields = {"database_url": "postgresql://u@h/d", "s3_internal_url": "http://s", "s3_access_key": "k"}
    return Settings(**fields, s3_secret_key="s", lab_name="Lab", public_url="https://lab.example")  # type: ignore[arg-type]


def _status(*items: StatusItem, capacities: tuple[CapacityForecast, ...] = ()) -> AdminStatus:
    return AdminStatus(
        now=NOW,
        version="1",
        is_healthy=not items,
        items=[*items],
        stored_bytes=3_000_000_000_000,
        stored_bytes_per_day=20_000_000_000,
        capacities=[*capacities],
    )


def test_the_report_of_a_healthy_server_says_so() -> None:
    assert report_subject(_status(), _settings()) == "Lab: healthy"
    text = report_text(_status(), _settings())
    assert "Healthy: nothing needs your attention." in text
    assert "Stored: 3.0 TB; 20.0 GB more a day" in text
    assert "https://lab.example/admin?tab=health" in text


def test_the_report_names_what_is_wrong_and_when_limits_are_reached() -> None:
    kinds = (StatusSeverity.problem, StatusSeverity.warning)
    items = [StatusItem(severity=kind, subject="jobs", message="Late.", remedy="Start one.") for kind in kinds]
    capacities = (
        forecast(None, CapacityUnit.bytes, used=40, limit=100, per_day=6, now=NOW),
        forecast(ROBOTS, CapacityUnit.files, used=1, limit=9, per_day=0, now=NOW),
    )
    status = _status(*items, capacities=capacities)
    assert report_subject(status, _settings()) == "Lab: problems: 1, warnings: 1"
    lines = report_text(status, _settings()).splitlines()
    assert "PROBLEM jobs: Late. Start one." in lines
    assert "Store: 40 B of 100 B; 6 B more a day; full on 2026-05-16." in lines
    assert "Quota of Robots: 1 of 9 files; 0 files more a day; not full within ten years." in lines
