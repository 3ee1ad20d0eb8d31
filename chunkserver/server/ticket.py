"""Tickets as a resource: what a browser's WebSocket comes with, in the place of a key."""

from typing import Annotated, Final

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, Field

from chunkserver.errors import BadParameter, Overloaded
from chunkserver.server.access import KEY_NAME, scope_of
from chunkserver.server.openapi import problem_responses
from chunkserver.server.parameters import NoQuery, WorldId, refuse_repeats
from chunkserver.server.problems import OtherGenerator, UnknownWorld
from chunkserver.server.service import ServiceOfApp
from chunkserver.server.stream import STREAM_PATH
from chunkserver.server.tickets import TICKET_SECONDS, Ticket
from chunkserver.server.worlds import WORLD

router: Final = APIRouter(dependencies=[Depends(refuse_repeats)], tags=["edits"])


class NewTicket(BaseModel):
    """What to open a WebSocket with."""

    ticket: str = Field(description="For the parameter `ticket` of the stream's URL: good once.")
    seconds: float = Field(description="For how long it is good.")


@router.post(
    f"{WORLD}/tickets",
    summary="A ticket for the stream of edits",
    responses=problem_responses(BadParameter, UnknownWorld, OtherGenerator, Overloaded),
)
async def new_ticket(
    world: WorldId, _query: Annotated[NoQuery, Query()], request: Request, service: ServiceOfApp, response: Response
) -> NewTicket:
    """A browser cannot send an API key with a WebSocket: it asks for a ticket with it before."""
    service.worlds.find(world)
    response.headers["Cache-Control"] = "no-store"
    path = STREAM_PATH.replace("{world}", world)
    ticket = Ticket(path, request.scope.get(KEY_NAME, ""), scope_of(request.scope))
    return NewTicket(ticket=service.tickets.mint(ticket), seconds=TICKET_SECONDS)
