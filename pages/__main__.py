"""Writes what is generated in docs/ and prints each file as it is done: all of it, or what is named."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from pages import meshes, nodes, pictures, tables
from pages.views import VIEWS

DOCS: Final = Path(__file__).parents[1] / "docs"

Generator = Callable[[Path], Path]

GENERATORS: Final[dict[str, Generator]] = {
    "nodes": nodes.write_nodes,
    "levels": tables.write_levels,
    **{f"picture-{view.name}": partial(pictures.write, view) for view in VIEWS},
    "skirts": meshes.write_skirts,
    "meshes": meshes.write_page,
    **{f"mesh-{picture.name}": partial(meshes.write_picture, picture) for picture in meshes.PICTURES},
}
"""Name -> a function that writes one file below the folder it is given, and returns the file's path."""


def main() -> None:
    """Run the generators that are named, all of them if none is."""
    parser = argparse.ArgumentParser(prog="python -m pages", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(GENERATORS)}")
    chosen = parser.parse_args().names or list(GENERATORS)
    if unknown := set(chosen) - set(GENERATORS):
        parser.error(f"no generator is named {sorted(unknown)}; there are {list(GENERATORS)}")
    for name in chosen:
        print(GENERATORS[name](DOCS).relative_to(DOCS.parent), flush=True)


if __name__ == "__main__":
    main()
