"""What one writes with FastAPI to serve chunks that are there already, on our HTTP server: a peer of `benchmarks.bare`.

Run as `python -m benchmarks.idiomatic FILE`: FILE is a pickle of what `benchmarks.bare.learn` returns.
"""

import pickle
import sys
from pathlib import Path
from typing import Annotated

from fastapi import FastAPI, Header, HTTPException, Query, Response
from fastapi import Path as PathParameter

from benchmarks.bare import Answer
from chunkserver.grid import LOD_MAX
from chunkserver.server import listen, serve

Coordinate = Annotated[int, PathParameter(ge=-(1 << 40), lt=1 << 40)]


def application(answers: dict[str, tuple[Answer, Answer]]) -> FastAPI:
    """Return an application that knows every chunk by its path, typed parameters and all."""
    app = FastAPI()

    @app.get("/readyz")
    async def ready() -> dict[str, str]:
        return {"status": "ready"}

    @app.get("/v1/seeds/{seed}/chunks/{lod}/{x}/{y}/{z}")
    async def chunk(
        seed: int,
        lod: Annotated[int, PathParameter(ge=0, le=LOD_MAX)],
        x: Coordinate,
        y: Coordinate,
        z: Coordinate,
        recipe: Annotated[str, Query(max_length=64)] = "terrain",
        cells: Annotated[int, Query(ge=16, le=64)] = 32,
        if_none_match: Annotated[str | None, Header()] = None,
    ) -> Response:
        found = answers.get(f"/v1/seeds/{seed}/chunks/{lod}/{x}/{y}/{z}")
        if found is None or (recipe, cells) != ("terrain", 32):
            raise HTTPException(404)
        whole, unchanged = found
        if if_none_match == _headers(whole)["etag"]:
            return Response(status_code=304, headers=_headers(unchanged))
        return Response(content=whole.body, headers=_headers(whole))

    return app


def _headers(answer: Answer) -> dict[str, str]:
    return {name.decode(): value.decode() for name, value in answer.headers if name != b"content-length"}


if __name__ == "__main__":
    serve(application(pickle.loads(Path(sys.argv[1]).read_bytes())), listen("127.0.0.1", 0))
