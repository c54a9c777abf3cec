"""The commands of docs/running.md set up a server of systemd units, on a machine with Debian's systemd."""

import re
from collections.abc import Iterator

import pytest

from tests.integration.deploy.machine import ROOT, Machine, machine
from tests.integration.upload_client import wait_until

# Making the machine takes minutes.
pytestmark = [pytest.mark.soak, pytest.mark.timeout(1800)]
_NAME = "kleinkram.lab.example"
_SERVICES = ("store", "api@8000", "api@8001", "worker@1")
_ONCE = ("bucket", "migrate", "check", "backup")
_MAX_EXPOSURE = 3.0
_WATCHDOG_S = 60
# What a browser does: the first admin, and a token for `klein login`.
_CLAIM = f"""
import sys, urllib3
url, code = "https://{_NAME}", sys.argv[1]
admin = {{"code": code, "name": "Ada", "email": "ada@lab.example", "password": "correct horse battery"}}
answer = urllib3.request("POST", url + "/api/v1/auth/bootstrap", json=admin, headers={{"Origin": url}})
assert answer.status == 200, answer.data
headers = {{"Origin": url, "Cookie": answer.headers["set-cookie"].split(";")[0]}}
print(urllib3.request("POST", url + "/api/v1/tokens", json={{"name": "laptop"}}, headers=headers).json()["secret"])
"""
_KLEIN = 'PATH="/opt/kleinkram/bin:$PATH"; cd /root; '


@pytest.fixture(scope="module")
def server() -> Iterator[Machine]:
    page = (ROOT / "docs" / "running.md").read_text()
    section = page[page.index("## Run with systemd") : page.index("## Run with Docker Compose")]
    commands = re.findall(r"```bash\n(.*?)```", section, re.DOTALL)
    with machine() as started:
        (started.disk / "etc" / "hosts").write_text(f"127.0.0.1 localhost {_NAME}\n")
        wheels = "export PIP_NO_INDEX=1 PIP_FIND_LINKS=/root/wheels; cd /root"
        log = started.run("\n".join([wheels, *commands]), timeout_s=600)
        code = re.findall(r"bootstrap code: ([^\"]+)", log)[-1]
        started.run(f"{_KLEIN} python - '{code}' > token <<'PYTHON'\n{_CLAIM}PYTHON")
        started.run(f"{_KLEIN} klein login https://{_NAME} --token < token")
        yield started


def test_everything_runs_after_the_commands_of_the_page(server: Machine) -> None:
    assert server.run("systemctl --failed --plain --no-legend") == ""
    assert [server.property_of(f"kleinkram-{name}", "ActiveState") for name in _SERVICES] == ["active"] * len(_SERVICES)
    assert [server.property_of(f"kleinkram-{name}", "Result") for name in _ONCE] == ["success"] * len(_ONCE)
    check = server.run("journalctl -o cat -u kleinkram-check")
    assert "proxy headers" in check
    assert not re.search(r"^(PROBLEM|WARNING)", check, re.MULTILINE), check


def test_units_are_hardened_as_systemd_sees_them(server: Machine) -> None:
    for name in (*_SERVICES, *_ONCE, "up"):
        report = server.run(f"systemd-analyze security --no-pager kleinkram-{name}.service")
        exposure = float(re.findall(r"Overall exposure level for .*: (\d+\.\d)", report)[0])
        assert exposure <= _MAX_EXPOSURE, report


def test_a_file_goes_through_the_proxy_and_into_the_backup_of_the_timer(server: Machine) -> None:
    server.run(f"{_KLEIN} klein sample field --size 20MB; klein project create lab")
    server.run(f"{_KLEIN} klein upload -p lab -m day-1 --create --wait field; klein verify -p lab -m day-1 field")
    soon = "/run/systemd/system/kleinkram-backup.timer.d/soon.conf"
    settings = r"[Timer]\nOnCalendar=\nOnActiveSec=1\nRandomizedDelaySec=0\nAccuracySec=1ms\n"
    server.run(f"mkdir -p $(dirname {soon}); printf '{settings}' > {soon}; systemctl daemon-reload")
    server.run("systemctl restart kleinkram-backup.timer")
    listing = f"{_KLEIN} ls /mnt/backups/snapshots | wc -l"
    wait_until(lambda: int(server.run(listing)) >= 2, limit_s=120)
    wait_until(lambda: server.property_of("kleinkram-backup", "ActiveState") == "inactive", limit_s=120)
    assert server.property_of("kleinkram-backup", "Result") == "success"
    server.run(f"rm {soon}; systemctl daemon-reload; systemctl restart kleinkram-backup.timer")


@pytest.mark.parametrize(
    ("unit", "sign", "within_s"),
    [
        pytest.param("kleinkram-worker@1", "KILL", 60, id="a worker that is killed"),
        pytest.param("kleinkram-store", "KILL", 60, id="a store that is killed"),
        pytest.param("kleinkram-api@8000", "STOP", _WATCHDOG_S + 60, id="an API process that hangs"),
    ],
)
def test_systemd_restarts(server: Machine, unit: str, sign: str, within_s: float) -> None:
    pid = server.property_of(unit, "MainPID")
    assert int(pid) > 0, "0 would be the processes of this test"
    server.run(f"kill -{sign} {pid}")
    wait_until(lambda: server.property_of(unit, "MainPID") not in {pid, "0"}, limit_s=within_s)
    wait_until(lambda: server.property_of(unit, "ActiveState") == "active", limit_s=60)


def test_everything_is_back_after_a_reboot(server: Machine) -> None:
    server.stop()
    server.boot()
    assert server.run("systemctl --failed --plain --no-legend") == ""
    assert "4 of 4 files are the same" in server.run(f"{_KLEIN} klein verify -p lab -m day-1 field")
    server.run("systemctl start kleinkram-check")
