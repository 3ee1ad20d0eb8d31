"""The page at `/about`: what this is, one chunk to look at, and the first requests to try."""

import html
from pathlib import Path
from string import Template
from typing import Final

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse

from chunkserver.server.openapi import RESOURCE, problem_responses
from chunkserver.server.recipes import DESCRIBED

_PAGE: Final = Template(Path(__file__).with_name("landing.html").read_text(encoding="utf-8"))
_RECIPES: Final = "\n".join(
    f'  <li><a href="/v1/recipes/{row.name}">{row.name}</a>: {html.escape(row.description)}</li>'
    for row in DESCRIBED.values()
)

router: Final = APIRouter(tags=["operations"])


@router.api_route(
    "/about",
    methods=RESOURCE,
    summary="About this server",
    response_class=HTMLResponse,
    responses={200: {"description": "A page for people."}, **problem_responses()},
)
async def landing(request: Request) -> HTMLResponse:
    """What this server is, with links to its documentation and an example chunk."""
    server = html.escape(str(request.base_url).rstrip("/"))
    return HTMLResponse(_PAGE.substitute(server=server, recipes=_RECIPES))
