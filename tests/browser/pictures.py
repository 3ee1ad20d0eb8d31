"""Pictures that a page has taken."""

import base64
import io

import numpy as np
from PIL import Image


def pixels(picture: str) -> np.ndarray:
    """Return RGB, (height, width, 3) uint8, of a PNG in base64."""
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB"))
