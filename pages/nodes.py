"""docs/recipes/nodes.md: every node, as its model says it. Nothing on that page is written twice."""

import json
from pathlib import Path
from typing import Any, Final

from chunkserver.field.tape import REGISTERS_MAX
from chunkserver.recipe import nodes
from chunkserver.recipe.node import Facts
from chunkserver.recipe.reading import COST_MAX, DEPTH_MAX, NODES_MAX, SOURCE_BYTES_MAX
from pages.fields import describe

INTRODUCTION: Final = f"""\
<!-- Written by `python -m pages nodes` from the models in chunkserver/recipe/: change those, not this page. -->
# Nodes of a recipe

A recipe is an expression tree in JSON. Each node is an object with an `op`; a bare number is a `constant`. A node is a
number at each point of the world: a density (negative is rock, 0 and more is air), a height, or a weight. Positions and
lengths are in voxels, y is up, and the point is p = (x, y, z). Nothing in a recipe is ever run as code.
[The guide](guide.md) shows how nodes become worlds.

A recipe has at most {NODES_MAX:,} nodes, {DEPTH_MAX} levels of JSON and {SOURCE_BYTES_MAX >> 10} KiB. Each node states
its cost in nanoseconds a sample, on the machine of [the performance page](../performance.md); those of a recipe add up
to at most {COST_MAX:,.0f}. What is equal in a tree is worked out once, and what does not depend on y once for a column,
so most recipes cost less than that sum. What does not depend on y, different constants included, is kept for all of a
column: at most {REGISTERS_MAX} such values. A recipe with a value that is not finite somewhere in the world is refused:
when it is posted, or by a chunk of the level at which a `mean` makes it so.

*Bound* says where a node's values lie; *feature* by which size levels of detail fade it. At a level whose samples are
`step` voxels apart, what is 8 steps large is whole, what is 4 steps or less is gone, and in between it fades linearly.
What has no feature size never fades. LOD 0 is the recipe itself.
"""

EXAMPLES: Final[dict[str, dict[str, Any]]] = {
    "constant": {"value": 3},
    "x": {},
    "random": {"salt": 1},
    "heightfield": {"height": {"op": "fbm2", "frequency": 0.02, "octaves": 5}},
    "plane": {"normal": [0, 1, 0.5]},
    "sphere": {"radius": 48},
    "box": {"half_extents": [8, 40, 8], "rounding": 2},
    "capsule": {"a": [0, 0, 0], "b": [0, 40, 10], "radius": 6},
    "torus": {"radius": 40, "tube": 8},
    "cylinder": {"radius": 12, "half_height": 30},
    "add": {"a": {"op": "y"}, "b": 8},
    "smooth_min": {"a": {"op": "y"}, "b": {"op": "sphere", "radius": 30}, "radius": 12},
    "abs": {"a": {"op": "simplex3", "frequency": 0.02}},
    "clamp": {"a": {"op": "y"}, "low": -8, "high": 8},
    "select": {"by": {"op": "x"}, "below": {"op": "y"}, "above": {"op": "sphere", "radius": 30}, "width": 16},
    "remap": {"a": {"op": "fbm2", "frequency": 0.01, "octaves": 4}, "points": [[-1, -20], [0, 0], [0.1, 16], [1, 24]]},
    "gradient2": {"frequency": 0.02},
    "cellular2": {"frequency": 0.02, "returns": "edge"},
    "fbm2": {"frequency": 0.02, "octaves": 5},
    "translate": {"a": {"op": "sphere", "radius": 48}, "offset": [0, 60, 0]},
    "scale": {"a": {"op": "sphere", "radius": 48}, "factor": [1, 0.5, 1]},
    "rotate": {"a": {"op": "torus", "radius": 40, "tube": 8}, "quaternion": [1, 0, 0, 1]},
    "repeat": {"a": {"op": "sphere", "radius": 10}, "period": [64, 0, 64]},
    "warp": {"a": {"op": "y"}, "y": {"op": "simplex3", "frequency": 0.02}},
    "detail": {"a": {"op": "fbm2", "frequency": 0.02, "octaves": 5}, "factor": 2},
}
"""An example of each model, by the first of its ops."""


def write_nodes(docs: Path) -> Path:
    """Write docs/recipes/nodes.md; return its path."""
    sections = [_section(title, models) for title, models in nodes.SECTIONS.items()]
    path = docs / "recipes" / "nodes.md"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([INTRODUCTION, *sections]).rstrip() + "\n")
    return path


def _section(title: str, models: tuple[type[nodes.Node], ...]) -> str:
    return "\n".join([f"## {title}\n", *map(_node, models)])


def _node(model: type[nodes.Node]) -> str:
    ops = list(model.facts)
    text = "\n".join(line.removeprefix("    ") for line in str(model.__doc__).splitlines())
    example = json.dumps({"op": ops[0], **EXAMPLES[ops[0]]})
    rows = [_facts(op, facts) for op, facts in model.facts.items()]
    fields = [describe(name, model) for name in model.model_fields if name != "op"]
    table = ["| field | value | default |", "|---|---|---|", *fields, ""] if fields else []
    head = ["| op | value | bound | feature | cost, ns |", "|---|---|---|---|---|"]
    return "\n".join(
        [f"### {', '.join(ops)}\n", text.strip(), "", *head, *rows, "", *table, "```json", example, "```\n"]
    )


def _facts(op: str, facts: Facts) -> str:
    return f"| `{op}` | {_cell(facts.formula)} | {_cell(facts.bound)} | {facts.feature or '-'} | {_cost(facts)} |"


def _cost(facts: Facts) -> str:
    return f"{facts.cost:g} each {facts.per}" if facts.per else f"{facts.cost:g}"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
