"""What is in a file, and whether it is what docs/wire says. Made for files of strangers: nothing here raises for one.

    file -> native.examine or gltf.examine -> Findings: facts as JSON has them, faults by byte or by JSON path

A reader for people who look at files, not the way to draw one. Numbers in a file are taken for sizes only after they
were found to be within the file.
"""

from chunkserver.wire.reading.findings import Fault, Findings
from chunkserver.wire.reading.gltf import examine as examine_gltf
from chunkserver.wire.reading.native import examine as examine_native

__all__ = ["Fault", "Findings", "examine_gltf", "examine_native"]
