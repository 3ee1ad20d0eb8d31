"""Pages that are generated say what the code says."""

import json

import pytest

from chunkserver.recipe import BUILTINS, canonical, nodes
from pages.nodes import EXAMPLES, write_nodes
from tests.house.checkout import ROOT

MODELS = [model for models in nodes.SECTIONS.values() for model in models]


def test_the_page_of_nodes_is_current(tmp_path):
    """If a node has changed: `python -m pages nodes`."""
    assert (ROOT / "docs" / "recipes" / "nodes.md").read_text() == write_nodes(tmp_path).read_text()


def test_the_table_of_levels_has_every_built_in():
    """If one is new: `python -m pages levels`. The figures are those of `make torture`."""
    rows = (ROOT / "docs" / "recipes" / "levels.md").read_text().split("## Maximum")[0].splitlines()
    names = [row.split("|")[1].strip() for row in rows if row.startswith("| ")]
    assert names[2:] == sorted(BUILTINS)


@pytest.mark.parametrize("op", EXAMPLES)
def test_an_example_is_a_recipe(op):
    assert json.loads(canonical({"op": op, **EXAMPLES[op]}))["op"] == op


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_op_has_its_facts(model):
    schema = json.dumps(model.model_json_schema())
    assert all(f'"{op}"' in schema for op in model.facts)
    place = model.model_fields["op"].annotation
    assert set(place.__args__) == set(model.facts)
    assert all(facts.cost >= 0 and facts.formula and facts.bound for facts in model.facts.values())
