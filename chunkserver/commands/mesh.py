"""`chunkserver mesh`: a chunk, or a box of chunks, as a file."""

import itertools
import math
import sys
from collections import Counter
from dataclasses import replace
from pathlib import PurePath
from typing import Annotated, Any, Final, Literal, NamedTuple, cast, get_args

import typer

from chunkserver.commands.building import build
from chunkserver.commands.files import PIPE, check_writable, write
from chunkserver.commands.given import RecipeOption, SeedOption, recipe_of
from chunkserver.commands.loading import load
from chunkserver.commands.saying import counted, end, say_json
from chunkserver.commands.warm import make_ready
from chunkserver.commands.welding import CHUNKS_MAX, weld
from chunkserver.errors import BadParameter
from chunkserver.grid import CELLS_DEFAULT, ChunkKey
from chunkserver.mesh import Content
from chunkserver.pipeline import ChunkRequest, build_chunk, check_request
from chunkserver.recipe import RECIPE_DEFAULT, WorldRecipe
from chunkserver.wire import FORMATS, Encoding, Placement

app: Final = typer.Typer(add_completion=False, rich_markup_mode=None)

Form = Literal["glb", "mesh", "ply", "obj", "stl"]
Frame = Literal["world", "box"]
Profile = Literal["std", "f32"]
Corner = tuple[int, int, int]

_FRAMES: Final = {"world": "world", "box": "chunk"}
"""What a frame is called on the wire, where a box is one chunk."""


class _Asked(NamedTuple):
    """What shall be written. first: the request for the box's low corner. high: the key of its high corner."""

    first: ChunkRequest
    high: ChunkKey
    form: Form
    frame: Frame

    @property
    def is_of_wire(self) -> bool:
        """Whether it is a chunk in a format of the wire. Then the bytes are those that the server sends."""
        return self.first.key == self.high and self.form in FORMATS

    @property
    def keys(self) -> list[ChunkKey]:
        """All chunks of the box."""
        ends = zip(self.first.key[1:], self.high[1:], strict=True)
        return [ChunkKey(self.high.lod, *place) for place in itertools.product(*(range(a, b + 1) for a, b in ends))]

    @property
    def corner(self) -> tuple[float, float, float]:
        """Where the low corner of the box is in the world, metres."""
        x, y, z = (self.first.voxel_size * low for low in self.first.key.low_corner(self.first.cells))
        return x, y, z


class _Made(NamedTuple):
    """What will be written, and what there is to say of it. error: metres by which positions may be off."""

    body: bytes
    vertices: int
    triangles: int
    contents: Counter[Content]
    error: float = 0.0


@app.command()
def command(
    file: Annotated[str, typer.Argument(metavar="FILE", help="Where to write; - is stdout, and needs --format.")],
    chunk: Annotated[Corner | None, typer.Option("--chunk", metavar="X Y Z", help="One chunk.")] = None,
    box: Annotated[
        tuple[int, int, int, int, int, int] | None,
        typer.Option("--box", metavar="X Y Z X Y Z", help="All chunks from the first to the second, both included."),
    ] = None,
    lod: Annotated[int, typer.Option("--lod", metavar="NUMBER", help="Level of detail, 0 to 20; 0 is finest.")] = 0,
    recipe: RecipeOption = RECIPE_DEFAULT,
    seed: SeedOption = 0,
    cells: Annotated[int, typer.Option("--cells", metavar="16|32|64", help="Cells a side of a chunk.")] = CELLS_DEFAULT,
    voxel_size: Annotated[float, typer.Option("--voxel-size", metavar="METRES", help="Of one voxel.")] = 1.0,
    form: Annotated[Form | None, typer.Option("--format", help="If the file's name does not end in it.")] = None,
    profile: Annotated[
        Profile | None, typer.Option("--profile", help="Of a .mesh: how numbers are written.  [std]")
    ] = None,
    frame: Annotated[
        Frame | None,
        typer.Option("--frame", help="The origin: the world's, or the box's low corner.  [.glb: world, else: box]"),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Say as JSON what was written.")] = False,
) -> None:
    """Write a chunk, or a box of chunks, to a file: .glb, .ply, .obj or .stl; one chunk also to a .mesh.

    One chunk as .glb or .mesh is to the byte what the server sends. All else is welded by exact positions: a surface
    that is closed stays closed. If there is only air or rock, nothing is written, and the exit code is 1.
    """
    wanted = _form(file, form)
    low, high = _corners(chunk, box)
    shown: Frame = frame or ("world" if wanted == "glb" else "box")
    world = WorldRecipe(seed, recipe_of(recipe).source)
    first = ChunkRequest(world, ChunkKey(lod, *low), cells, voxel_size)
    asked = _Asked(first, ChunkKey(lod, *high), wanted, shown)
    asked = asked._replace(first=replace(first, encoding=_encoding(asked, profile, frame)))
    _check(asked, file, as_json)
    make_ready()
    made = _chunk(asked) if asked.is_of_wire else _box(asked)
    write(file, made.body)
    _say(file, asked, made, as_json)


def _form(file: str, form: Form | None) -> Form:
    wanted = form or PurePath(file).suffix.removeprefix(".").lower()
    if wanted not in get_args(Form):
        choice = ", ".join(f".{known}" for known in get_args(Form))
        raise BadParameter(f"{file!r} ends in none of {choice}: then --format is needed", file=file)
    return cast(Form, wanted)


def _corners(chunk: Corner | None, box: tuple[int, ...] | None) -> tuple[Corner, Corner]:
    if (chunk is None) is (box is None):
        raise BadParameter("what to write is needed: either --chunk X Y Z, or --box X Y Z X Y Z")
    x, y, z, *last = (*chunk, *chunk) if chunk is not None else box or ()
    low, high = (x, y, z), (last[0], last[1], last[2])
    sides = [end - begin + 1 for begin, end in zip(low, high, strict=True)]
    if min(sides) < 1:
        raise BadParameter(f"the box goes from {low} to {high}: its low corner comes first", box=box)
    if math.prod(sides) > CHUNKS_MAX:
        shown = " x ".join(map(str, sides))
        raise BadParameter(f"the box has {shown} chunks: {math.prod(sides):,}, and at most {CHUNKS_MAX:,}", box=box)
    return low, high


def _encoding(asked: _Asked, profile: Profile | None, frame: Frame | None) -> Encoding:
    """Return how chunks are built: as the server does, or for a box of them with normals as floats."""
    if profile is not None and asked.form != "mesh":
        raise BadParameter(f"--profile {profile} does not apply to .{asked.form}", profile=profile)
    if frame is not None and asked.form == "mesh":
        raise BadParameter(f"--frame {frame} does not apply to .mesh: its positions are the chunk's", frame=frame)
    if not asked.is_of_wire:
        return Encoding(profile="f32")
    return Encoding("mesh", profile or "std") if asked.form == "mesh" else Encoding("glb", frame=_FRAMES[asked.frame])


def _check(asked: _Asked, file: str, as_json: bool) -> None:
    """Refuse what cannot be before anything is built. Both ends of the box are in the world if its corners are."""
    for key in (asked.first.key, asked.high):
        check_request(replace(asked.first, key=key))
    if asked.form == "mesh" and not asked.is_of_wire:
        raise BadParameter("a .mesh holds one chunk: write a box as .glb, .ply, .obj or .stl")
    if file == PIPE and as_json:
        raise BadParameter("--json says on stdout what was written: the file cannot go there too")
    if file == PIPE and sys.stdout.isatty():
        raise BadParameter("the file would be written to the terminal: send it on, or name one")
    check_writable(file)


def _chunk(asked: _Asked) -> _Made:
    """Return a chunk as the server sends it."""
    built = build_chunk(asked.first)
    contents = Counter([built.content])
    _refuse_nothing(contents)
    facts = FORMATS[asked.form].examine(built.body).facts
    return _Made(built.body, facts["vertices"], facts["triangles"], contents)


def _box(asked: _Asked) -> _Made:
    """Return a welded box of chunks."""
    built = build(asked.first, asked.keys)
    _refuse_nothing(built.contents)
    welded = weld(built.surfaces, asked.first.key, asked.high)
    exporting = load("chunkserver.commands.exporting")
    unit = Placement(asked.first.key, asked.first.cells, asked.first.voxel_size).unit
    placed = exporting.Placed(unit, asked.corner, asked.frame == "world")
    body, error = exporting.export(welded, placed, asked.form)
    return _Made(body, len(welded.points), len(welded.triangles), built.contents, error)


def _refuse_nothing(contents: Counter[Content]) -> None:
    if not contents["surface"]:
        what = " and ".join(f"{count:,} {content}" for content, count in sorted(contents.items()))
        end(f"there is no surface in {counted(contents.total(), 'chunk')}: {what}. Nothing was written")


def _say(file: str, asked: _Asked, made: _Made, as_json: bool) -> None:
    if as_json:
        say_json(_described(file, asked, made))
        return
    chunks = counted(made.contents.total(), "chunk")
    empty = made.contents.total() - made.contents["surface"]
    chunks += f" ({empty:,} without a surface)" if empty else ""
    size = f"{made.vertices:,} vertices, {made.triangles:,} triangles, {len(made.body):,} bytes"
    said = [f"{file}: {chunks}, {size}"]
    if asked.form != "mesh" and asked.frame == "box":
        said.append(f"its origin is the box's low corner, at ({', '.join(f'{x:.15g}' for x in asked.corner)}) m")
    if made.error:
        remedy = "--frame box keeps them near it" if asked.frame == "world" else "its numbers have no more digits"
        said.append(f"its positions are off by up to {made.error:.2g} m: {remedy}")
    for line in said:
        typer.echo(line, err=file == PIPE)


def _described(file: str, asked: _Asked, made: _Made) -> dict[str, Any]:
    first = asked.first
    return {
        "file": file,
        "format": asked.form,
        "bytes": len(made.body),
        "lod": asked.high.lod,
        "low": list(first.key[1:]),
        "high": list(asked.high[1:]),
        "chunks": {content: made.contents[content] for content in get_args(Content)},
        "vertices": made.vertices,
        "triangles": made.triangles,
        "seed": str(first.recipe.seed),
        "recipe": first.recipe.digest,
        "cells": first.cells,
        "voxel_size": first.voxel_size,
        "frame": None if asked.form == "mesh" else asked.frame,
        "origin": list(asked.corner) if asked.frame == "box" and asked.form != "mesh" else [0.0, 0.0, 0.0],
        "position_error": made.error,
    }
