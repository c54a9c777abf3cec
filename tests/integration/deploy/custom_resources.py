"""Checks resources of operators, which are not part of Kubernetes: the fields that their APIs allow and require.

Source: API references of the Prometheus operator (monitoring.coreos.com/v1) and the Gateway API (v1). Fields that the
chart has no use for are left out, and so refused.
"""

from collections.abc import Mapping
from typing import Any

from jsonschema import Draft202012Validator

_Schema = dict[str, Any]
_DURATION = {"type": "string", "pattern": r"^([0-9]+y)?([0-9]+w)?([0-9]+d)?([0-9]+h)?([0-9]+m)?([0-9]+s)?([0-9]+ms)?$"}
_TIMEOUT = {"type": "string", "pattern": r"^([0-9]{1,5}(h|m|s|ms)){1,4}$"}
_LABEL = {"type": "string", "pattern": r"^[a-zA-Z_][a-zA-Z0-9_]*$"}
_NAME = {"type": "string", "pattern": r"^[a-z0-9]([-a-z0-9]*[a-z0-9])?$", "maxLength": 63}
_HOST = {"type": "string", "pattern": r"^(\*\.)?[a-z0-9]([-a-z0-9]*[a-z0-9])?(\.[a-z0-9]([-a-z0-9]*[a-z0-9])?)*$"}
_PORT = {"type": "integer", "minimum": 1, "maximum": 65535}
_TEXTS = {"type": "object", "additionalProperties": {"type": "string"}}


def _fields(*required: str, **fields: _Schema) -> _Schema:
    return {"type": "object", "additionalProperties": False, "required": [*required], "properties": fields}


def _list(item: _Schema, *, most: int = 1000) -> _Schema:
    return {"type": "array", "items": item, "minItems": 1, "maxItems": most}


_RELABELING = _fields(
    sourceLabels=_list(_LABEL),
    separator={"type": "string"},
    targetLabel={"type": "string"},
    regex={"type": "string"},
    replacement={"type": "string"},
    action={"enum": ["replace", "keep", "drop", "labelmap", "labeldrop", "labelkeep"]},
)
_RULE = _fields(
    "expr",
    alert={"type": "string", "minLength": 1},
    record={"type": "string", "minLength": 1},
    expr={"type": ["string", "integer"]},
    keep_firing_for=_DURATION,
    labels=_TEXTS,
    annotations=_TEXTS,
    **{"for": _DURATION},
)
_BACKEND = _fields("name", "port", name=_NAME, namespace=_NAME, port=_PORT, weight={"type": "integer"})
_PATH_MATCH = _fields(
    "type",
    "value",
    type={"enum": ["Exact", "PathPrefix"]},
    value={"type": "string", "pattern": r"^/\S*$", "maxLength": 1024},
)
_SPECS: Mapping[tuple[str, str], _Schema] = {
    ("monitoring.coreos.com/v1", "ServiceMonitor"): _fields(
        "endpoints",
        "selector",
        selector=_fields("matchLabels", matchLabels=_TEXTS),
        endpoints=_list(
            _fields("port", port=_NAME, path={"type": "string"}, interval=_DURATION, relabelings=_list(_RELABELING))
        ),
    ),
    ("monitoring.coreos.com/v1", "PrometheusRule"): _fields(
        groups=_list(
            _fields("name", name={"type": "string", "minLength": 1}, interval=_DURATION, rules=_list(_RULE)),
        )
    ),
    ("gateway.networking.k8s.io/v1", "HTTPRoute"): _fields(
        parentRefs=_list(_fields("name", name=_NAME, namespace=_NAME, sectionName=_NAME, port=_PORT), most=32),
        hostnames=_list(_HOST, most=16),
        rules=_list(
            _fields(
                matches=_list(_fields(path=_PATH_MATCH), most=64),
                backendRefs=_list(_BACKEND, most=16),
                timeouts=_fields(request=_TIMEOUT, backendRequest=_TIMEOUT),
            ),
            most=16,
        ),
    ),
}


def problems_of(manifest: Mapping[str, Any]) -> list[str]:
    """Return what an API server with the operator's definitions would refuse."""
    spec = _SPECS[manifest["apiVersion"], manifest["kind"]]
    metadata = _fields("name", name=_NAME, labels=_TEXTS, annotations=_TEXTS)
    schema = _fields("spec", apiVersion={}, kind={}, metadata=metadata, spec=spec)
    return [f"{error.json_path}: {error.message}" for error in Draft202012Validator(schema).iter_errors(manifest)]
