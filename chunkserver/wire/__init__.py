"""Which bytes: the formats that a finished mesh is served in."""

from chunkserver.wire.encoding import ENCODING_DEFAULT, Encoding, Placement, check_placement
from chunkserver.wire.formats import FORMATS, Format, check_encoding, encode

__all__ = [
    "ENCODING_DEFAULT",
    "FORMATS",
    "Encoding",
    "Format",
    "Placement",
    "check_encoding",
    "check_placement",
    "encode",
]
