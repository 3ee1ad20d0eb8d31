"""Pictures and their page as files: panels put together, labels, JPEG, Markdown."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from chunkserver.recipe import WorldRecipe, canonical
from pages.meshes.chunks import served
from pages.meshes.drawing import draw
from pages.meshes.pictures import PICTURES, Panel, Picture

FOLDER: Final = Path("pictures/meshes")
PAGE: Final = Path("meshes.md")
QUALITY: Final = 86
LABEL_PIXELS: Final = 17
LABEL_PLACE: Final = (16, 12)
LABEL_INK: Final = (36, 40, 52)
LABEL_HALO: Final = (246, 243, 236)
LINE_LENGTH: Final = 120
GAP: Final = 4
"""Pixels between panels."""

HEAD: Final = """\
<!-- Written by `python -m pages meshes`: change pages/meshes/pictures.py, not this page. -->
# What the meshes look like

The pictures on this page are drawn from the bytes that the server sends, decoded by the Python client and put at their
places: nothing is mended on the way. `make docs ARGS=mesh-NAME` draws one of them again, in less than a minute and
without a GPU or a display. It needs OpenGL in software, which Linux has in Mesa (Debian: `libegl1`). A new picture is a
new row in `pages/meshes/pictures.py`, and this page comes from there too (`make docs ARGS=meshes`).
"""

SECTION: Final = """
## {title}

{caption}

![{name}]({folder}/{name}.jpg)

`make docs ARGS=mesh-{name}`
"""


def write_picture(picture: Picture, docs: Path) -> Path:
    """Draw a picture into its file below `docs` and return the path."""
    drawn = [_labelled(panel) for panel in picture.panels]
    path = docs / FOLDER / f"{picture.name}.jpg"
    path.parent.mkdir(parents=True, exist_ok=True)
    together = Image.fromarray(_together(drawn, picture.columns))
    together.save(path, quality=QUALITY, optimize=True, progressive=True, subsampling=0)
    return path


def write_page(docs: Path) -> Path:
    """Write the page that shows all pictures and return its path."""
    sections = [
        SECTION.format(title=p.title, caption=fill(p.caption, LINE_LENGTH), name=p.name, folder=FOLDER.as_posix())
        for p in PICTURES
    ]
    path = docs / PAGE
    path.write_text(HEAD + "".join(sections))
    return path


def _labelled(panel: Panel) -> NDArray[np.uint8]:
    view = panel.view
    meshes = served(WorldRecipe(view.seed, canonical(view.recipe)), view.keys, view.seam)
    triangles = sum(len(mesh.triangles) for mesh in meshes)
    image = Image.fromarray(draw(view, meshes))
    ImageDraw.Draw(image).text(
        LABEL_PLACE,
        panel.label.format(triangles=f"{triangles:,}", chunks=len(meshes)),
        fill=LABEL_INK,
        stroke_fill=LABEL_HALO,
        stroke_width=2,
        font=ImageFont.load_default(LABEL_PIXELS),
    )
    return np.asarray(image)


def _together(panels: Sequence[NDArray[np.uint8]], columns: int) -> NDArray[np.uint8]:
    """Return the panels, all of one size, as rows of `columns`, white in between."""
    height, width, _ = panels[0].shape
    rows = -(-len(panels) // columns)
    whole = np.full((rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3), 255, np.uint8)
    for number, panel in enumerate(panels):
        top, left = number // columns * (height + GAP), number % columns * (width + GAP)
        whole[top : top + height, left : left + width] = panel
    return whole
