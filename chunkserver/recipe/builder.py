"""Recipes in Python: one name for each op, and arithmetic on what they return.

    from chunkserver.recipe.builder import fbm2, maximum, simplex3, y

    hills = y - fbm2(octaves=5, frequency=0.02) * 24
    caves = (simplex3(frequency=0.05) - 0.6) * 6
    print(maximum(hills, caves).model_dump_json())

The result is a node: the same JSON, and the same checks, as if it had been written by hand. Fields are those of the
node, by name; operands come first and may be numbers. A wrong field is a `BadRecipe` at once.
"""

from functools import partial
from typing import Any, Final, Protocol

from chunkserver.recipe.node import Node, make


class _Maker(Protocol):
    def __call__(self, **fields: Any) -> Node: ...


class _Wrapper(Protocol):
    def __call__(self, a: Node | float, /, **fields: Any) -> Node: ...


class _Joiner(Protocol):
    def __call__(self, a: Node | float, b: Node | float, /, *more: Node | float, **fields: Any) -> Node: ...


def _of_one(op: str, operand: str = "a") -> _Wrapper:
    def wrap(a: Node | float, /, **fields: Any) -> Node:
        return make(op, **{operand: a}, **fields)

    return wrap


def _of_two(op: str) -> _Joiner:
    def join(a: Node | float, b: Node | float, /, *more: Node | float, **fields: Any) -> Node:
        joined = make(op, a=a, b=b, **fields)
        for other in more:
            joined = make(op, a=joined, b=other, **fields)
        return joined

    return join


x: Final = make("x")
y: Final = make("y")
z: Final = make("z")

minimum: Final = _of_two("min")
maximum: Final = _of_two("max")
smooth_min: Final = _of_two("smooth_min")
smooth_max: Final = _of_two("smooth_max")

clamp: Final = _of_one("clamp")
select: Final = _of_one("select", "by")
remap: Final = _of_one("remap")
heightfield: Final = _of_one("heightfield", "height")
translate: Final = _of_one("translate")
scale: Final = _of_one("scale")
rotate: Final = _of_one("rotate")
repeat: Final = _of_one("repeat")
warp: Final = _of_one("warp")
detail: Final = _of_one("detail")

random: Final[_Maker] = partial(make, "random")
plane: Final[_Maker] = partial(make, "plane")
sphere: Final[_Maker] = partial(make, "sphere")
box: Final[_Maker] = partial(make, "box")
capsule: Final[_Maker] = partial(make, "capsule")
torus: Final[_Maker] = partial(make, "torus")
cylinder: Final[_Maker] = partial(make, "cylinder")

gradient2: Final[_Maker] = partial(make, "gradient2")
gradient3: Final[_Maker] = partial(make, "gradient3")
value2: Final[_Maker] = partial(make, "value2")
value3: Final[_Maker] = partial(make, "value3")
simplex2: Final[_Maker] = partial(make, "simplex2")
simplex3: Final[_Maker] = partial(make, "simplex3")
cellular2: Final[_Maker] = partial(make, "cellular2")
cellular3: Final[_Maker] = partial(make, "cellular3")
fbm2: Final[_Maker] = partial(make, "fbm2")
fbm3: Final[_Maker] = partial(make, "fbm3")
ridged2: Final[_Maker] = partial(make, "ridged2")
ridged3: Final[_Maker] = partial(make, "ridged3")
billow2: Final[_Maker] = partial(make, "billow2")
billow3: Final[_Maker] = partial(make, "billow3")
