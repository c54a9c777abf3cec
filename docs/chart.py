"""Generated parts of the Helm chart: the schema of `settings`, and the table of values in its README."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic_settings import NoDecode
from ruamel.yaml import YAML

from kleinkram.server.settings import Settings, is_secret

_CHART = Path(__file__).parents[1] / "deploy" / "helm" / "kleinkram"
_TABLE = "## Values\n"
# Settings that other values set, or that are for one machine.
_SET_BY_VALUES = frozenset(
    {"metrics_address", "metrics_port", "owner_token_file", "public_url", "serving_role", "store_folder"}
    | {"trusted_proxies", *(name for name in Settings.model_fields if name.startswith("s3_"))}
)
_LIMITS = ("type", "enum", "minimum", "maximum", "exclusiveMinimum", "minLength", "maxLength", "pattern")
_KINDS = {
    "#/$defs/secret": " (`name`, `key`)",
    "#/$defs/temporaryVolume": " `ephemeral`: a volume of its own; `emptyDir`: the disk of the node.",
}
# With credentials, it is a secret.
_PUBLIC_INDEX = {"type": "string", "pattern": "^[^@]*$"}


def chart_pages() -> dict[Path, str]:
    """Return the schema and the README of the chart."""
    path = _CHART / "values.schema.json"
    schema = json.loads(path.read_text(encoding="utf-8"))
    schema["properties"]["settings"]["properties"] = dict(_settings())
    readme = (_CHART / "README.md").read_text(encoding="utf-8")
    text, _, _ = readme.partition(_TABLE)
    defaults = YAML(typ="safe").load(_CHART / "values.yaml")
    rows = "\n".join(_rows(schema, defaults, "", "required"))
    return {
        path: json.dumps(schema, indent=1, ensure_ascii=False) + "\n",
        _CHART / "README.md": f"{text}{_TABLE}\n| value | default | meaning |\n|---|---|---|\n{rows}\n",
    }


def _settings() -> Iterator[tuple[str, dict[str, Any]]]:
    """Return the limits of each setting that is neither a secret nor another value of the chart."""
    schema = Settings.model_json_schema()
    for name in sorted(Settings.model_fields):
        if name == "package_index":
            yield f"KLEINKRAM_{name.upper()}", _PUBLIC_INDEX
        elif not is_secret(name) and name not in _SET_BY_VALUES:
            own = _limits(schema["properties"][name], schema["$defs"])
            if NoDecode in Settings.model_fields[name].metadata:  # separated by commas, not JSON
                own = {"type": "string"}
            is_list = own.get("type") not in {"string", "integer", "number", "boolean"}
            yield f"KLEINKRAM_{name.upper()}", {"type": ["string", "array"]} if is_list else own


def _limits(field: Mapping[str, Any], definitions: Mapping[str, Any]) -> dict[str, Any]:
    """Return the limits in the schema of a setting; one that may be unset has those of its value."""
    value = next((option for option in field.get("anyOf", ()) if option.get("type") != "null"), field)
    value = definitions.get(value.get("$ref", "").rpartition("/")[2], value)
    return {key: value[key] for key in value if key in _LIMITS}


def _rows(group: Mapping[str, Any], defaults: Mapping[str, Any], prefix: str, required: str) -> Iterator[str]:
    """Return a row for each value. `required`: what the table says where there must be one, and no default."""
    for name, value in group["properties"].items():
        path, is_required, default = f"{prefix}{name}", name in group.get("required", ()), defaults.get(name)
        if "properties" in value and name != "settings":
            inner = required if is_required or default else f"required with `{path}`"
            yield from _rows(value, default or {}, f"{path}.", inner)
        elif name != "global":
            shown = required if is_required and default is None else _shown(default)
            yield f"| `{path}` | {shown} | {value['description']}{_KINDS.get(value.get('$ref'), '')} |"


def _shown(default: object) -> str:
    if isinstance(default, dict):
        default = {name: value for name, value in default.items() if value != ""}
    return "" if default in (None, "") else f"`{json.dumps(default)}`".replace('"', "")
