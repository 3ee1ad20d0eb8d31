"""What tests want to know about trees."""

from chunkserver.recipe import nodes
from chunkserver.recipe.reading import parse


def cost_of(source: str) -> float:
    """Return the cost of a recipe in canonical JSON, ns a sample."""
    return _cost(parse(source))


def _cost(node: nodes.Node) -> float:
    return node.cost() + sum(_cost(child) for _, child in node.children())
