"""Whether the server lives, and whether it is ready: for load balancers, containers and tests."""

from typing import Final, Literal

from fastapi import APIRouter, Response
from pydantic import BaseModel

from chunkserver.errors import Unavailable
from chunkserver.server.openapi import RESOURCE, header, problem_responses
from chunkserver.server.service import ServiceOfApp

_NO_STORE: Final = {"Cache-Control": header("Always `no-store`.")}


class Live(BaseModel):
    """The server answers."""

    status: Literal["alive"] = "alive"


class Ready(BaseModel):
    """A chunk can be built at once."""

    status: Literal["ready"] = "ready"


router: Final = APIRouter(tags=["operations"])


@router.api_route(
    "/livez",
    methods=RESOURCE,
    summary="Whether the server answers",
    responses={200: {"description": "It does.", "headers": _NO_STORE}, **problem_responses()},
)
async def livez(response: Response) -> Live:
    """Answers as soon as the server listens, also while kernels are being compiled."""
    response.headers["Cache-Control"] = "no-store"
    return Live()


@router.api_route(
    "/readyz",
    methods=RESOURCE,
    summary="Whether chunks can be built",
    responses={200: {"description": "They can.", "headers": _NO_STORE}, **problem_responses(Unavailable)},
)
async def readyz(service: ServiceOfApp, response: Response) -> Ready:
    """503 until the kernels are compiled (once per version) and the workers run."""
    if not service.pool.ready:
        raise Unavailable("the workers are not ready: kernels are being compiled or loaded")
    response.headers["Cache-Control"] = "no-store"
    return Ready()
