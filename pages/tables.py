"""The page that shows what each level of each built-in recipe costs."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from chunkserver.recipe import BUILTINS, WorldRecipe, builtin
from pages.levels import CHUNKS_ASIDE, GROWTH_MAX, LODS, STRAY_CELLS, Level, measure, place_of

SEED: Final = 42

PAGE: Final = """\
<!-- Written by `python -m pages levels`: change pages/tables.py, not this page. -->
# Triangles per level

What one chunk of 32 cells costs at each level of detail, for every built-in recipe. A row is measured in a reference
view: {aside} × {aside} × {aside} chunks of one level around a place of the recipe, seed {seed}. The view has the same
number of chunks at every level, so it is twice as wide at each: what is sharp nearby is seen in coarser chunks further
away.

Detail that is finer than a level can show fades out ([how](../CONVENTIONS.md#levels-of-detail)). Without that, coarse
levels would be made of speckle. Two rules hold for every built-in (`tests/property/test_levels_triangles.py`):

- no level has more than {growth:g} times the triangles per chunk of LOD 0, in the mean and at most;
- no closed piece of surface is smaller than {stray} cells, unless it is all there is to see. `terrain` breaks
  this at LOD 0 and 1, `planet` and `continents` at LOD 1: where a cave only grazes the ground, chips of rock are left.

## Mean

Triangles per chunk, over the chunks that have any.

{means}

## Maximum

{maxima}

## Stray pieces

Closed pieces of surface whose extent along every axis is under {stray} cells.

{strays}
"""


def write_levels(docs: Path) -> Path:
    """Measure every built-in recipe and write docs/recipes/levels.md; return its path."""
    measured = {name: levels_of(name) for name in sorted(BUILTINS)}
    text = PAGE.format(
        aside=CHUNKS_ASIDE,
        seed=SEED,
        growth=GROWTH_MAX,
        stray=STRAY_CELLS,
        means=_table(measured, lambda level: f"{level.triangles_mean:,.0f}"),
        maxima=_table(measured, lambda level: f"{level.triangles_max:,}"),
        strays=_table(measured, lambda level: str(level.stray)),
    )
    path = docs / "recipes" / "levels.md"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def levels_of(name: str, aside: int = CHUNKS_ASIDE) -> list[Level]:
    """Return the figures of every level of a built-in recipe."""
    recipe = WorldRecipe(SEED, builtin(name))
    return [measure(recipe, place_of(name), lod, aside) for lod in LODS]


def _table(measured: dict[str, list[Level]], cell: Callable[[Level], str]) -> str:
    rows = [["recipe", *(f"LOD {lod}" for lod in LODS)], ["---", *("--:" for _ in LODS)]]
    rows += [[name, *map(cell, levels)] for name, levels in measured.items()]
    return "\n".join(map(_row, rows))


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
