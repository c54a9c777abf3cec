"""The actions that are shipped: each script beside this file is one, of the version of the package.

A script describes itself in its header (PEP 723) and runs where its `dependencies` are installed. The rest of Kleinkram
reads the scripts, but never imports one, nor the packages that it needs. `inputs` is what the scripts share.
"""

import functools
from collections.abc import Mapping
from importlib import resources
from types import MappingProxyType

from kleinkram.contract.actions import ActionDefinition
from kleinkram.contract.scripts import has_header, read_script


@functools.cache
def shipped_actions() -> Mapping[str, ActionDefinition]:
    """Return the shipped actions by name, in the order of their names."""
    files = (file for file in resources.files(__name__).iterdir() if file.name.endswith(".py"))
    texts = {file.name.removesuffix(".py"): file.read_text(encoding="utf-8") for file in files}
    scripts = (read_script(text, name=stem) for stem, text in texts.items() if has_header(text))
    return MappingProxyType({script.name: script for script in sorted(scripts, key=lambda script: script.name)})
