import pytest
from pydantic import TypeAdapter, ValidationError

from chunkserver.errors import BadParameter, BadRecipe
from chunkserver.recipe import WorldRecipe, builtin
from chunkserver.server.parameters import AnyQuery, Decimal, encoding_of, pristine
from chunkserver.server.posted import PostedRecipes
from chunkserver.wire import Encoding

DECIMAL = TypeAdapter(Decimal)
NOT_CANONICAL = [
    "",
    "+1",
    "01",
    "00",
    "-0",
    "-01",
    "1_0",
    " 1",
    "1 ",
    "1\n",
    "1.0",
    "1e3",
    "0x1",
    "١",
    "²",
    "--1",
    "9" * 20,
]


@pytest.mark.parametrize("text", ["0", "1", "-1", "10", "-120", str(2**63 - 1), str(-(2**63))])
def test_integers_in_their_shortest_form(text):
    assert DECIMAL.validate_python(text) == int(text)


@pytest.mark.parametrize("text", [*NOT_CANONICAL, 1, 1.0, True, None, ["1"]])
def test_no_other_form(text):
    with pytest.raises(ValidationError, match="must be a decimal integer"):
        DECIMAL.validate_python(text)


@pytest.mark.parametrize(
    ("format_name", "query", "expected"),
    [
        ("mesh", {}, Encoding("mesh", "std", "world")),
        ("mesh", {"profile": "f32"}, Encoding("mesh", "f32", "world")),
        ("glb", {}, Encoding("glb", "std", "world")),
        ("glb", {"frame": "chunk"}, Encoding("glb", "std", "chunk")),
        ("glb", {"frame": "world"}, Encoding("glb", "std", "world")),
        ("mesh", {"profile": "nonsense"}, Encoding("mesh", "nonsense", "world")),  # refused by check_request
    ],
)
def test_encodings(format_name, query, expected):
    assert encoding_of(format_name, AnyQuery(**query)) == expected


@pytest.mark.parametrize(("format_name", "query"), [("mesh", {"frame": "world"}), ("glb", {"profile": "std"})])
def test_what_does_not_apply_is_refused_even_if_it_is_the_default(format_name, query):
    with pytest.raises(BadParameter, match="does not apply") as caught:
        encoding_of(format_name, AnyQuery(**query))
    assert query.items() <= caught.value.values.items()


def test_worlds():
    posted = PostedRecipes()
    assert pristine(7, "hills", posted) == WorldRecipe(7, builtin("hills")) != pristine(7, "terrain", posted)
    with pytest.raises(BadRecipe):
        pristine(7, "nonsense", posted)
    with pytest.raises(BadRecipe):
        pristine(2**63, "hills", posted)
