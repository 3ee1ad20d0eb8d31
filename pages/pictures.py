"""The pictures of the recipes."""

from pathlib import Path
from typing import Final

from PIL import Image

from chunkserver.recipe import WorldRecipe, canonical
from pages.renderer import render
from pages.scenes import build
from pages.views import View

FOLDER: Final = Path("recipes/pictures")
QUALITY: Final = 88


def write(view: View, docs: Path) -> Path:
    """Draw a view into its file below `docs` and return the path."""
    scene = build(WorldRecipe(view.seed, canonical(view.recipe)), view.camera, view.extent)
    picture = render(scene, view.camera, view.light, view.ground, view.look)
    path = docs / FOLDER / f"{view.name}.jpg"
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(path, quality=QUALITY, optimize=True, progressive=True)
    return path
