"""Which bytes: the formats that a finished mesh is served in, and the codings that make them smaller."""

from chunkserver.wire.coding import CODINGS
from chunkserver.wire.encoding import Encoding, Placement
from chunkserver.wire.formats import FORMATS, check_encodable, encode

__all__ = ["CODINGS", "FORMATS", "Encoding", "Placement", "check_encodable", "encode"]
