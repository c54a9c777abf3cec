"""The entry point: `--help` is fast, and every command exists."""

import importlib
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from kleinkram.cli.main import ALIASES, COMMANDS, app

HEAVY = ("pydantic", "urllib3", "rich", "anycrc", "kleinkram.client", "kleinkram.contract", "kleinkram.standalone")


def test_help_imports_nothing_heavy() -> None:
    program = (
        "import sys, atexit; sys.argv = ['klein', '--help']; "
        "atexit.register(lambda: print('\\nMODULES', *sys.modules)); "
        "from kleinkram.cli.main import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    shown, _, modules = done.stdout.partition("MODULES")
    assert [name for name in modules.split() if name in HEAVY] == []
    assert all(f"  {name} " in shown for name in COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name: str) -> None:
    shown = CliRunner().invoke(app, [name, "--help"])
    assert shown.exit_code == 0, shown.output
    assert "Usage:" in shown.output
    module, attribute, _ = COMMANDS[name]
    assert getattr(importlib.import_module(f"kleinkram.cli.{module}"), attribute)


@pytest.mark.parametrize(("alias", "name"), ALIASES.items())
def test_aliases_of_the_original_work_and_are_not_listed(alias: str, name: str) -> None:
    run = CliRunner()
    assert run.invoke(app, [alias, "--help"]).output == run.invoke(app, [name, "--help"]).output.replace(
        f"klein {name}", f"klein {alias}"
    )
    assert f"  {alias} " not in run.invoke(app, ["--help"]).output


@pytest.mark.parametrize("name", ["search", "stats", "download"])
def test_the_filter_options_are_the_same_everywhere(name: str) -> None:
    shown = CliRunner().invoke(app, [name, "--help"]).output
    for option in (
        "--query",
        "--project",
        "--where",
        "--topic",
        "--type",
        "--format",
        "--label",
        "--after",
        "--min-size",
    ):
        assert option in shown


def test_an_unknown_command_is_a_usage_error() -> None:
    assert CliRunner().invoke(app, ["frobnicate"]).exit_code == 2


def test_the_version_is_printed() -> None:
    import kleinkram

    assert CliRunner().invoke(app, ["--version"]).output == f"{kleinkram.__version__}\n"
