import json
import re
from typing import get_args

import pytest

from chunkserver.commands import key
from chunkserver.server.keys import Scope, digest_of_key
from tests.unit.commands.typed import run


def test_a_new_key_is_shown_once_with_what_the_server_keeps():
    said = run("key", "new", "--name", "game", "--scope", "edit").stdout
    (secret,) = re.findall(r"^    (chunkserver_\S+)$", said, re.MULTILINE)
    (line,) = re.findall(r'^    api_keys = \["(.+)"\]$', said, re.MULTILINE)
    (given,) = re.findall(r"^    CHUNKSERVER_API_KEYS=(\S+)$", said, re.MULTILINE)
    assert given == line == f"game:edit:{digest_of_key(secret)}"
    told = json.loads(run("config", "show", "--json", CHUNKSERVER_API_KEYS=line).stdout)
    assert told["api_keys"] == {"value": ["game:edit:***"], "from": "CHUNKSERVER_API_KEYS"}


def test_every_scope_can_be_had():
    assert get_args(key.Scope) == tuple(Scope)


@pytest.mark.parametrize(("name", "scope"), [("Game", "read"), ("game", "write")])
def test_a_key_that_cannot_be(name, scope):
    ended = run("key", "new", "--name", name, "--scope", scope)
    assert ended.exit_code == 2
    assert not ended.stdout
