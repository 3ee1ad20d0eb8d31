"""The built-in recipes, a file for each world: what stands here a user could have written.

Each is a function from its parameters to an expression, made with `chunkserver.recipe.builder`.
"""
