"""docs/api.md names everything that the application has: routes, parameters, headers, statuses, problems, options."""

import re
from pathlib import Path

import pytest
from fastapi.routing import iter_route_contexts

from chunkserver.grid import CELLS_BUILT, CELLS_DEFAULT, LOD_MAX
from chunkserver.recipe import BUILTINS
from chunkserver.server import Settings, create_app
from chunkserver.server.problems import PROBLEMS, TYPE_PREFIX
from chunkserver.server.worlds import BODY_BYTES_MAX, PAGE_DEFAULT, PAGE_MAX, NewWorld
from chunkserver.store.catalogue import SOURCES_BYTES_MAX
from chunkserver.wire import FORMATS
from chunkserver.world import LODS_DEFAULT, WORLDS_MAX

PAGE = (Path(__file__).parents[2] / "docs/api.md").read_text(encoding="utf-8")
NAMED = set(re.findall(r"`([^`\n]+)`", PAGE))
"""What stands in backquotes."""


@pytest.fixture(scope="module")
def app():
    return create_app(Settings())


@pytest.fixture(scope="module")
def operations(app):
    return [operation for path in app.openapi()["paths"].values() for operation in path.values()]


def test_every_route(app):
    paths = {route.path for route in iter_route_contexts(app.routes)}
    assert len(paths) >= 12
    assert paths <= NAMED
    assert paths >= set(app.openapi()["paths"])


def test_every_parameter_and_every_value_of_it(operations):
    parameters = [parameter for operation in operations for parameter in operation.get("parameters", [])]
    assert len({parameter["name"] for parameter in parameters}) >= 12
    for parameter in parameters:
        assert parameter["name"] in NAMED
        assert set(map(str, parameter["schema"].get("enum", []))) <= NAMED
        assert str(parameter["schema"].get("default") or 0) in NAMED


def test_every_header_and_status(operations):
    for operation in operations:
        for status, response in operation["responses"].items():
            assert re.search(rf"\b{status}\b", PAGE), status
            assert set(response.get("headers", {})) <= NAMED | {"Retry-After"}


@pytest.mark.parametrize("problem", {row.name: row for row in PROBLEMS.values()}.values(), ids=lambda row: row.name)
def test_every_problem_and_its_status(problem):
    assert f"| `{problem.name}` | {problem.status} |" in PAGE
    assert f"`{TYPE_PREFIX}`" in PAGE


def test_no_problem_that_is_none():
    rows = re.findall(r"^\| `([a-z-]+)` \| \d\d\d \|", PAGE, re.MULTILINE)
    assert sorted(rows) == sorted({row.name for row in PROBLEMS.values()})


def test_every_format_and_recipe():
    assert {row.extension for row in FORMATS.values()} <= NAMED
    assert {row.media_type for row in FORMATS.values()} <= NAMED
    assert set(BUILTINS) <= NAMED


@pytest.mark.parametrize("name", ["SeedDescriptor", "WorldDescriptor", "NewWorld", "Worlds", "ListedWorld", "Limits"])
def test_every_member_of_a_body(app, name):
    bodies = {"NewWorld": NewWorld.model_json_schema(), **app.openapi()["components"]["schemas"]}
    assert set(bodies[name]["properties"]) <= NAMED


def test_the_limits_of_worlds():
    for limit in (WORLDS_MAX, BODY_BYTES_MAX):
        assert f"{limit:,}" in PAGE
    assert f"{SOURCES_BYTES_MAX >> 20} MiB together" in PAGE
    assert f"1 to {PAGE_MAX}, `{PAGE_DEFAULT}` when left out" in PAGE
    assert f"| `lods` | 1 to {LOD_MAX + 1} | {LODS_DEFAULT} |" in PAGE
    assert f"| `chunk_cells` | {CELLS_BUILT[0]}, {CELLS_BUILT[1]} or {CELLS_BUILT[2]} | {CELLS_DEFAULT} |" in PAGE
