"""What may stand in a field of a node, in words: read off the model's JSON Schema."""

import math
from typing import Any

from pydantic import BaseModel


def describe(name: str, model: type[BaseModel]) -> str:
    """Return the row of a table: name, what may stand there, default."""
    field = model.model_fields[name]
    schema = model.model_json_schema()
    place = schema if "properties" in schema else schema["$defs"][schema["$ref"].rsplit("/", 1)[-1]]
    words = kind(place["properties"][name])
    note = f". {field.description}" if field.description else ""
    default = "required" if field.is_required() else f"`{_shown(field.default)}`"
    return f"| `{name}` | {words}{note} | {default} |"


def kind(schema: dict[str, Any]) -> str:
    """Return what a schema lets pass, in words."""
    match schema:
        case {"discriminator": _} | {"$ref": _} | {"oneOf": _}:
            return "a node or a number"
        case {"anyOf": choices}:
            return ", or ".join(kind(choice) for choice in choices)
        case {"enum": names}:
            return " or ".join(f"`{name}`" for name in names)
        case {"type": "array", "prefixItems": items}:
            words = {kind(item) for item in items}
            return f"[{', '.join(['…'] * len(items))}], each {words.pop()}"
        case {"type": "array", "items": items}:
            return f"{schema['minItems']} to {schema['maxItems']} pairs, {kind(items)}"
    article = {"integer": "whole number", "number": "number"}[schema["type"]]
    return f"{article}, {_range(schema)}"


def _range(schema: dict[str, Any]) -> str:
    low = schema["minimum"] if "minimum" in schema else schema["exclusiveMinimum"]
    high = schema["maximum"] if "maximum" in schema else schema["exclusiveMaximum"]
    if low == -high:
        return f"±{number(high)}"
    return f"{number(low)} to {number(high)}" + (" exclusive" if "exclusiveMaximum" in schema else "")


def number(value: float) -> str:
    """Return a number as people write it: large and small powers of two as such."""
    mantissa, exponent = math.frexp(abs(value))
    if mantissa == 0.5 and (exponent > 11 or exponent < -3):
        return f"{'-' if value < 0 else ''}2^{exponent - 1}"
    return f"{value:g}"


def _shown(default: Any) -> str:
    if isinstance(default, BaseModel):
        return f"{getattr(default, 'value', default):g}"
    if isinstance(default, tuple):
        return f"[{', '.join(f'{part:g}' for part in default)}]"
    return default if isinstance(default, str) else f"{default:g}"
