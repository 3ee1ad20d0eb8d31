"""What a world is made of: a recipe is an expression tree written as JSON, never code."""

from chunkserver.recipe import nodes
from chunkserver.recipe.builtins import BUILTINS, RECIPE_DEFAULT, builtin, canonical
from chunkserver.recipe.world import WorldRecipe

__all__ = ["BUILTINS", "RECIPE_DEFAULT", "WorldRecipe", "builtin", "canonical", "nodes"]
