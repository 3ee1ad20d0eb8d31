"""`chunkserver inspect`: what is in a file of a chunk."""

from typing import Annotated, Any, Final

import typer

from chunkserver.commands.files import read
from chunkserver.commands.saying import FAILED, counted, end, say_json
from chunkserver.wire import FORMATS

app: Final = typer.Typer(add_completion=False, rich_markup_mode=None)

FILE_BYTES_MAX: Final = 1 << 26
"""Half as much again as the largest chunk: 64 cells a side, all of them crossed, in floats."""
MAGIC_BYTES: Final = 4


@app.command()
def command(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A .mesh or a .glb; - reads what is piped in.")],
    as_json: Annotated[bool, typer.Option("--json", help="As one JSON object.")] = False,
) -> None:
    """Say what is in a file of a chunk, and whether it is right, as docs/wire has it.

    Each fault is a line on stderr, which names the byte, or the path in the JSON of a GLB. With faults the exit code
    is 1.
    """
    content = read(file, FILE_BYTES_MAX + 1)
    if len(content) > FILE_BYTES_MAX:
        end(f"{file} has more than {counted(FILE_BYTES_MAX, 'byte')}: it is no chunk")
    row = next((row for row in FORMATS.values() if content.startswith(row.magic)), None)
    if row is None:
        known = " or ".join(f"{row.magic.decode()} ({row.extension})" for row in FORMATS.values())
        end(f"{file} begins with {content[:MAGIC_BYTES]!r}: a file of a chunk begins with {known}")
    facts, faults = row.examine(content)
    if as_json:
        say_json({**facts, "faults": [fault._asdict() for fault in faults]})
    else:
        for name, value in _lines(facts):
            typer.echo(f"{name:<10} {value}")
        for fault in faults:
            typer.echo(f"{file}: {fault.where}: {fault.what}", err=True)
        if not faults:
            typer.echo(f"{'':<10} it is what docs/wire says")
    if faults:
        raise typer.Exit(FAILED)


def _lines(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """Return what is said of the facts to a person: a name and a value a line. Any of them may not be there."""
    lines = [("format", f"{facts['format']}, {counted(facts['bytes'], 'byte')}")]
    if "key" not in facts:
        return lines
    key = facts["key"]
    lines += [
        ("chunk", f"lod {key['lod']}, x {key['x']}, y {key['y']}, z {key['z']}"),
        ("cells", f"{facts['cells']} a side, voxels of {facts['voxel_size']} m"),
        ("content", f"{facts['content']}, revision {facts['revision']}, coarser {facts['coarser']}"),
        ("profile", ", ".join([facts["profile"], *(f"frame {facts[name]}" for name in ("frame",) if name in facts)])),
    ]
    if facts.get("vertices"):
        lines.append(("mesh", f"{facts['vertices']:,} vertices, {facts['triangles']:,} triangles"))
    if facts.get("bounds"):
        low, high = (_point(facts["bounds"]["metres"][name]) for name in ("low", "high"))
        lines.append(("bounds", f"{low} to {high} m"))
    for block in facts.get("blocks", ()):
        layout = f"{block['components']} x {block['type']}, stride {block['stride']}"
        lines.append((block["name"], f"{layout}, at {block['offset']}, {counted(block['bytes'], 'byte')}"))
    return lines


def _point(metres: list[float]) -> str:
    return f"({', '.join(f'{metre:.9g}' for metre in metres)})"
