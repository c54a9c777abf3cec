"""The ROS 2 types of common_interfaces and the core packages, for databases of rosbag2 that hold no definitions.

A recording's own definition always goes first. Few types have changed between releases: the definition of Humble
counts, and where it does not explain a message that of another release that does.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.resources import files

from kleinkram.recordings.decoding.msg_text import short_name


@lru_cache(maxsize=1)
def known_definitions() -> dict[str, list[str]]:
    """Return the definitions by short names ("sensor_msgs/Imu"): the default first, then those of other releases."""
    text = (files("kleinkram.recordings.decoding") / "well_known.txt").read_text("utf-8")
    found: dict[str, list[str]] = {}
    for line in text.splitlines():
        name, mark, definition = line.partition(":")
        if mark and not line.startswith("#"):
            found.setdefault(name, []).append(definition.strip().replace("; ", "\n"))
    return found


def well_known_definitions(name: str) -> list[str]:
    """Return the texts that may define a ROS 2 type ("sensor_msgs/msg/Imu"), the default first; none for other types.

    Each text has all types behind it that the type needs; each but the first takes one type from another release.
    """
    known = known_definitions()
    wanted = short_name(name)
    if wanted not in known or (name.count("/") > 1 and "/msg/" not in name):
        return []
    needed = _needed(wanted)
    default = {needed_name: known[needed_name][0] for needed_name in needed}
    others = [{**default, changed: other} for changed in needed for other in known[changed][1:]]
    return [_joined(wanted, definitions) for definitions in (default, *others)]


def _needed(root: str) -> list[str]:
    """Return a type and all that any of its definitions mention, at whatever depth."""
    known = known_definitions()
    needed = [root]
    for name in needed:
        package = name.partition("/")[0]
        lines = [line for definition in known[name] for line in definition.splitlines()]
        for kind in (line.partition(" ")[0].partition("[")[0] for line in lines):
            full = kind if "/" in kind else f"{package}/{kind}"
            if full in known and full not in needed:
                needed.append(full)
    return needed


def _joined(root: str, definitions: dict[str, str]) -> str:
    others = (f"===\nMSG: {name}\n{text}" for name, text in definitions.items() if name != root)
    return "\n".join([definitions[root] or "# no fields", *others])
