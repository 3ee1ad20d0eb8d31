"""Zstandard, of the standard library where that has it."""

import sys

if sys.version_info >= (3, 14):
    from compression.zstd import ZstdDecompressor, ZstdError, compress, zstd_version
else:
    from backports.zstd import ZstdDecompressor, ZstdError, compress, zstd_version

__all__ = ["ZstdDecompressor", "ZstdError", "compress", "zstd_version"]
