"""A fuzzer reads /openapi.json and looks for answers that it does not declare."""

import json
import subprocess
import sys
from pathlib import Path

import httpx2
import pytest

from chunkserver.recipe import BUILTINS
from tests import conftest, scale
from tests.serving import serving

CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_headers_conformance",
    "response_schema_conformance",
    "negative_data_rejection",
    "unsupported_method",
    "allow_header_conformance",
)
SETTINGS = """
[checks]
negative_data_rejection.expected-statuses = ["4xx"]
"""
"""Another generator than the current one is a 410, which is not among the fuzzer's own rejections."""
EXAMPLES_TORTURE = 2000


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with serving(tmp_path_factory.mktemp("server") / "log") as running:
        yield running


def test_no_undeclared_answer(server, tmp_path):
    document = tmp_path / "openapi.json"
    document.write_text(json.dumps(with_what_no_fuzzer_can_guess(server.url)))
    (tmp_path / "schemathesis.toml").write_text(SETTINGS)
    command = [
        str(Path(sys.executable).with_name("schemathesis")),
        "run",
        str(document),
        f"--url={server.url}",
        f"--checks={','.join(CHECKS)}",
        f"--max-examples={scale.count(EXAMPLES_TORTURE)}",
        f"--seed={conftest.SEED}",
        "--no-color",
    ]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=1800, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr


def with_what_no_fuzzer_can_guess(url):
    """The server's own document, but with names of recipes and worlds, generator tokens and epochs, without a parameter
    that excludes another one, and without the one that waits for an edit.

    Else every request would be wrong in two ways, and nothing could be seen of the one that was meant.
    """
    document = httpx2.get(f"{url}/openapi.json").json()
    posted = httpx2.post(f"{url}/v1/recipes", json={"builtin": "planet", "radius": 100}).json()["digest"]
    recipes = [*sorted(BUILTINS), posted, posted[::-1]]
    tokens = [httpx2.get(f"{url}/v1/seeds/0?recipe={name}").json()["generator"] for name in recipes[:-1]]
    worlds = [{"id": name, "seed": 0, "recipe": "terrain"} for name in ("kept", "deleted")]
    kept, _ = (httpx2.post(f"{url}/v1/worlds", json=world).json() for world in worlds)
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            parameters = {parameter["name"]: parameter for parameter in operation.get("parameters", [])}
            if "recipe" in parameters:
                parameters["recipe"]["schema"] = {"enum": recipes}
            if "g" in parameters:
                parameters["g"]["schema"] = {"enum": tokens}
            if "world" in parameters:
                parameters["world"]["schema"] = {"enum": ["deleted" if method == "delete" else kept["id"], "nobody"]}
            if "epoch" in parameters:
                parameters["epoch"]["schema"] = {"enum": [kept["epoch"]]}
            parameters.pop("min_revision", None)
            if path.endswith("{z}"):
                del parameters["frame"]
            operation["parameters"] = list(parameters.values())
    return document
