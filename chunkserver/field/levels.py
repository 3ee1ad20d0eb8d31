"""Band-limited levels: how much of a feature is left at a level of detail. One rule, in this one place.

Sampled every `step` voxels, a feature of `size` voxels (one lattice cell of noise) is whole from 8 steps up, gone at 4
steps and less, and fades linearly in between towards its mean. LOD 0 is the recipe itself: nothing fades.

    weight 1 |          ______
             |         /
           0 |________/
             0   4    8       size / step

What has faded may leave a cut behind that cuts nothing: caves that are gone are rock, a few voxels deep in density, at
every depth. A surface interpolated towards that constant lies wrong as soon as a cell is larger than those few voxels,
and has the wrong normals. So `visible` leaves out what can no longer show.
"""

import math
from itertools import product
from typing import Final

from chunkserver.recipe import nodes

STEPS_GONE: Final = 4.0
STEPS_WHOLE: Final = 8.0

assert 2.0 < STEPS_GONE < STEPS_WHOLE, "a feature must be gone before its sampling aliases (two steps a period)"


def weight(size: float, lod: int) -> float:
    """Return the weight in [0, 1] of a feature of `size` voxels at level `lod`."""
    if lod == 0:
        return 1.0
    steps = size / (1 << lod)
    return min(1.0, max(0.0, (steps - STEPS_GONE) / (STEPS_WHOLE - STEPS_GONE)))


def visible(root: nodes.Node, lod: int) -> nodes.Node:
    """Return the tree of level `lod`: without operands of `max` that are rock, of `min` that are air, everywhere.

    Only from the root through `min` and `max`: there an operand counts by its sign, and no sign changes. LOD 0 is the
    recipe itself.
    """
    if lod == 0 or not isinstance(root, nodes.Binary) or root.op not in {"min", "max"}:
        return root
    for kept, other in ((root.a, root.b), (root.b, root.a)):
        low, high = bounds(other, lod)
        if high < 0.0 if root.op == "max" else low > 0.0:
            return visible(kept, lod)
    return root.model_copy(update={"a": visible(root.a, lod), "b": visible(root.b, lod)})


def bounds(node: nodes.Node, lod: int) -> tuple[float, float]:
    """Return bounds (low, high) of a node's value anywhere in space at level `lod`, but for rounding."""
    match node:
        case nodes.Constant():
            return node.value, node.value
        case nodes.Sphere():
            return -node.radius, math.inf
        case nodes.Simplex3():
            left = weight(1.0 / node.frequency, lod)
            return -left, left
        case nodes.Fbm():
            bands = node.bands()
            left = sum(amplitude * weight(1.0 / frequency, lod) for frequency, amplitude in bands)
            left /= sum(amplitude for _, amplitude in bands)
            return -left, left
        case nodes.Binary():
            return _combined(node.op, bounds(node.a, lod), bounds(node.b, lod))
    return -math.inf, math.inf


def _combined(op: str, a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    match op:
        case "add":
            return a[0] + b[0], a[1] + b[1]
        case "subtract":
            return a[0] - b[1], a[1] - b[0]
        case "min":
            return min(a[0], b[0]), min(a[1], b[1])
        case "max":
            return max(a[0], b[0]), max(a[1], b[1])
    # Values are finite even where their bounds are not, so zero times anything is zero.
    products = [x * y if x and y else 0.0 for x, y in product(a, b)]
    return min(products), max(products)
