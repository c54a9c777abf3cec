"""The public names of the SDK, and the cost of importing it."""

import subprocess
import sys

import pytest

import kleinkram
import kleinkram.client
import kleinkram.client.transfer
from kleinkram.client.config import Endpoint, EndpointSource


def test_the_package_exports_its_public_names() -> None:
    assert kleinkram.__all__ == ["Client", "__version__", "connect"]
    assert kleinkram.connect is kleinkram.client.connect
    for module in (kleinkram, kleinkram.client, kleinkram.client.transfer):
        for name in module.__all__:
            assert getattr(module, name) is not None


def test_a_client_has_one_attribute_per_resource() -> None:
    with kleinkram.client.Client(Endpoint("x", "http://127.0.0.1:9", "t", EndpointSource.argument)) as client:
        names = {name for name in dir(client) if not name.startswith("_")} - {
            "endpoint",
            "close",
            "upload",
            "download",
            "cut_events",
            "export",
        }
        assert all(getattr(client, name) is getattr(client, name) for name in names)
        with pytest.raises(AttributeError, match="robots"):
            client.robots  # type: ignore[attr-defined]  # noqa: B018  that is what is tried
    assert names >= {"projects", "missions", "files", "recordings", "uploads", "trash", "stats", "audit"}
    assert names >= {"service", "me", "search", "actions", "runs"}


def test_exports_are_imported_on_first_use() -> None:
    program = (
        "import sys, kleinkram; client = kleinkram.connect('http://127.0.0.1:9', 'a token'); client.projects\n"
        "sys.exit(any(f'kleinkram.client.{name}' in sys.modules for name in ('actions', 'runs', 'admin', 'tokens')))"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_importing_the_package_imports_nothing_else() -> None:
    program = "import sys, kleinkram; sys.exit(any(name.startswith(('pydantic', 'urllib3')) for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
