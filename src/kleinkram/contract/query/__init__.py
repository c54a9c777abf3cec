"""The query language: one text for a whole search, the same in the CLI, the SDK, the server and the web.

`parse` makes a `FileFilter` of a text and `render` makes the text of a filter, in one order and spelling. Pure.
"""

from kleinkram.contract.query.parsing import parse, whole
from kleinkram.contract.query.rendering import render

__all__ = ["parse", "render", "whole"]
