"""Wheels and sdists contain the built web interface; without it, the build fails."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class WithTheApp(BuildHookInterface):  # type: ignore[type-arg]  # its parameter is private to the builder
    """Fails a wheel or sdist without the built web interface; `pip install -e` does not need it."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Check that the web interface is built.

        Raises:
            RuntimeError: it is not built.
        """
        del build_data
        page = Path(self.root) / "src" / "kleinkram" / "server" / "web" / "built" / "index.html"
        if version != "editable" and not page.is_file():
            raise RuntimeError(
                "the web interface is not built: run `make setup` first (see docs/developing-the-web.md)"
            )
