"""Pictures of the meshes that the server sends: shaded, as wireframe, with chunk borders and open edges."""

from pages.meshes.drawing import View, draw
from pages.meshes.pictures import PICTURES, Picture
from pages.meshes.skirts import write_skirts
from pages.meshes.writing import write_page, write_picture

__all__ = ["PICTURES", "Picture", "View", "draw", "write_page", "write_picture", "write_skirts"]
