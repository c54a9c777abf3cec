"""What is built from here has the web interface in it, or is not built at all."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class WithTheApp(BuildHookInterface):  # type: ignore[type-arg]  # its parameter is the builder's own affair
    """Refuses a wheel or an sdist without the built app; `pip install -e` may do without."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """See that the app is there.

        Raises:
            RuntimeError: it is not.
        """
        del build_data
        page = Path(self.root) / "src" / "kleinkram" / "server" / "web" / "built" / "index.html"
        if version != "editable" and not page.is_file():
            raise RuntimeError(
                "the web interface is not built: run `make setup` first (see docs/developing-the-web.md)"
            )
