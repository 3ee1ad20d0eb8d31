import warnings

import pytest

from chunkserver.server import Settings, create_app
from chunkserver.server.problems import MEDIA_TYPE
from tests.unit.server.stub import StubPool


@pytest.fixture(scope="module")
def document():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return create_app(Settings(), StubPool()).openapi()


def operations(document):
    return [(path, method, found) for path, methods in document["paths"].items() for method, found in methods.items()]


def test_every_operation_has_a_name_a_description_and_its_problems(document):
    names = [found["operationId"] for _, _, found in operations(document)]
    assert len(set(names)) == len(names) >= 10
    for path, method, found in operations(document):
        assert found["summary"], path
        assert found["description"], path
        assert "500" in found["responses"], path
        for status, response in found["responses"].items():
            assert response["description"], (path, status)
            if method == "get" and int(status) >= 400:
                assert list(response["content"]) == [MEDIA_TYPE], (path, status)
                assert response["content"][MEDIA_TYPE]["examples"], (path, status)
            if status == "503":
                assert "Retry-After" in response["headers"], path


def test_head_is_get_without_a_body(document):
    for path, methods in document["paths"].items():
        assert list(methods) == sorted(methods), "in this order, whatever strings hash to"
        assert set(methods) <= {"get", "head", "post", "delete"}
        assert ("get" in methods) == ("head" in methods)
        if "head" not in methods:
            assert set(methods) == {"post"}
            continue
        assert all("content" not in response for response in methods["head"]["responses"].values()), path
        assert set(methods["head"]["responses"]) == set(methods["get"]["responses"]), path


def test_every_parameter_is_explained(document):
    for path, _, found in operations(document):
        for parameter in found.get("parameters", []):
            assert parameter["description"], (path, parameter["name"])


def test_nothing_of_the_frameworks_own_errors_is_left(document):
    assert set(document["components"]["schemas"]) >= {"Problem", "SeedDescriptor", "WorldDescriptor"}
    assert not {"HTTPValidationError", "ValidationError"} & set(document["components"]["schemas"])


def test_values_are_named_once(document):
    for path, _, found in operations(document):
        for parameter in found.get("parameters", []):
            values = parameter["schema"].get("enum", [])
            assert len(values) == len(set(values)), (path, parameter["name"])
