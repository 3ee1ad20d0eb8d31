"""Which bytes: the formats that a finished mesh is served in."""

from chunkserver.wire.encoding import ENCODING_DEFAULT, Encoding, Placement
from chunkserver.wire.formats import FORMATS, check_encodable, encode

__all__ = ["ENCODING_DEFAULT", "FORMATS", "Encoding", "Placement", "check_encodable", "encode"]
