"""The OpenAPI document: what routes declare about their answers, and the little that FastAPI does not write itself."""

import warnings
from functools import cache, partial
from typing import Any, Final

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from chunkserver.server.problems import MEDIA_TYPE, PROBLEMS, RESERVED, problem_body

Responses = dict[int | str, dict[str, Any]]

RESOURCE: Final = ["GET", "HEAD"]
"""The methods of everything that can only be read."""
PROBLEM_REF: Final = {"$ref": "#/components/schemas/Problem"}
PROBLEM_SCHEMA: Final = {
    "title": "Problem",
    "description": "RFC 9457 problem details. Every further member is an offending value, by its name.",
    "type": "object",
    "required": sorted(RESERVED - {"instance"}),
    "properties": {
        "type": {"type": "string", "format": "uri", "enum": sorted({row.type for row in PROBLEMS.values()})},
        "title": {"type": "string"},
        "status": {"type": "integer", "minimum": 400, "maximum": 599},
        "detail": {"type": "string"},
        "instance": {
            "type": "string",
            "format": "uri",
            "description": "The request, by its `X-Request-Id`; not there if it had none.",
        },
    },
    "additionalProperties": True,
}


def header(description: str, pattern: str = ".+", required: bool = True) -> dict[str, Any]:
    """Return the declaration of a response header. required: it is always sent."""
    return {"description": description, "required": required, "schema": {"type": "string", "pattern": pattern}}


def problem_responses(*errors: type[Exception] | int) -> Responses:
    """Return the declarations of the problems that a route can answer with, and of the 500 that any can."""
    declared: Responses = {}
    for row in dict.fromkeys(PROBLEMS[error] for error in (*errors, Exception)):
        answer = declared.setdefault(row.status, {"description": "", "content": {MEDIA_TYPE: {}}, "headers": {}})
        answer["description"] = "; ".join(filter(None, (answer["description"], f"`{row.name}`: {row.title}")))
        content = answer["content"][MEDIA_TYPE]
        content["schema"] = PROBLEM_REF
        content.setdefault("examples", {})[row.name] = {"value": problem_body(row, "what was wrong, in a sentence", {})}
        if row.retry_after is not None:
            answer["headers"]["Retry-After"] = header("Seconds to wait before the request is sent again.", "^[0-9]+$")
    return declared


def install(app: FastAPI) -> None:
    """Make `app` describe itself with this module: FastAPI's own way to extend the document."""
    app.openapi = cache(partial(_describe, app))  # type: ignore[method-assign]


def _describe(app: FastAPI) -> dict[str, Any]:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Duplicate Operation ID")  # GET and HEAD of a route; see below
        document = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
    document.setdefault("components", {}).setdefault("schemas", {})["Problem"] = PROBLEM_SCHEMA
    for path, operations in document["paths"].items():
        document["paths"][path] = dict(sorted(operations.items()))  # FastAPI keeps the methods in a set
        if "head" in operations:
            _describe_head(operations["head"])
    return document


def _describe_head(operation: dict[str, Any]) -> None:
    operation["operationId"] = f"head_{operation['operationId']}"
    operation["summary"] = f"{operation['summary']} (headers only)"
    for response in operation["responses"].values():
        response.pop("content", None)
