"""Write the dashboards: `python -m tools.dashboards`. `--check` compares them instead, as a part of `make check`."""

import importlib.util
import json
import sys
from pathlib import Path

_ROOT = Path(__file__).parents[2]
_FOLDER = _ROOT / "deploy" / "observability" / "grafana" / "dashboards"


def main() -> int:
    """Write the files that differ, or with `--check` name them; returns 1 if there are any to name."""
    if importlib.util.find_spec("grafana_foundation_sdk") is None:
        sys.stderr.write("dashboards are neither written nor compared: the SDK of Grafana needs Python 3.11\n")
        return 0
    from tools.dashboards.definitions import DASHBOARDS  # which imports the SDK
    from tools.dashboards.panels import to_json

    texts = {f"{page.name}.json": json.dumps(to_json(page), indent=1, sort_keys=True) + "\n" for page in DASHBOARDS}
    current = {path.name: path.read_text(encoding="utf-8") for path in _FOLDER.glob("*.json")}
    stale = sorted(name for name in {*texts, *current} if texts.get(name) != current.get(name))
    if "--check" in sys.argv:
        for name in stale:
            sys.stderr.write(f"{(_FOLDER / name).relative_to(_ROOT)} is not up to date; run `make generated`\n")
        return 1 if stale else 0
    for name in stale:
        if name in texts:
            (_FOLDER / name).write_text(texts[name], encoding="utf-8")
        else:
            (_FOLDER / name).unlink()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
