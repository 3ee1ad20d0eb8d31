"""The image and its compose file, as far as they can be checked without a container engine."""

import http.server
import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path
from unittest import mock

import pytest
import yaml
from typer.main import get_command

from chunkserver.__main__ import app
from chunkserver.errors import BadSetting
from chunkserver.server import mint
from chunkserver.server.run import GRACE_SECONDS
from chunkserver.server.settings import PREFIX
from chunkserver.server.sources import choose

DOCKER = Path(__file__).parents[2] / "docker"
DOCKERFILE = DOCKER / "Dockerfile"
PORT = 8000


def instructions() -> list[tuple[str, str]]:
    """Return the Dockerfile's instructions in order, each with its arguments on one line."""
    lines = (line for line in DOCKERFILE.read_text().splitlines() if not line.startswith("#"))
    text = re.sub(r"\\\n\s*", "", "\n".join(lines))
    return [(name, arguments) for name, _, arguments in (line.partition(" ") for line in text.splitlines() if line)]


def last(name: str) -> str:
    return [arguments for instruction, arguments in instructions() if instruction == name][-1]


def compose(name="compose.yaml"):
    return yaml.safe_load((DOCKER / name).read_text())


def service(name="compose.yaml"):
    return compose(name)["services"]["chunkserver"]


def settings_of(*composed):
    """The settings of a container: what the image and the compose files say, the later ones last."""
    image = dict(word.split("=", 1) for name, line in instructions() if name == "ENV" for word in line.split())
    variables = image | {name: value for each in composed for name, value in each["environment"].items()}
    ours = {name: value for name, value in variables.items() if name.startswith(PREFIX)}
    with mock.patch.dict(os.environ, ours):
        return choose({})[0]


def test_hadolint_has_nothing_to_say():
    hadolint = Path(sys.executable).with_name("hadolint")
    subprocess.run([hadolint, DOCKERFILE], check=True)


def test_runs_without_root_rights():
    assert last("USER").isdigit(), "a number can be checked by the orchestrator, a name cannot"
    assert int(last("USER")) > 0


def test_installs_nothing_from_the_registry_but_what_the_locks_pin():
    installs = [
        command
        for _, line in instructions()
        for command in line.split("&&")
        if " install " in command and "pip" in command
    ]
    assert len(installs) == 3
    for command in installs:
        assert "--require-hashes" in command or "--no-deps /wheel/" in command, command


def test_the_command_line_knows_what_the_image_says():
    commands = get_command(app).commands  # type: ignore[attr-defined]
    name, *arguments = json.loads(last("CMD"))
    options = {flag for parameter in commands[name].params for flag in parameter.opts}
    assert {argument for argument in arguments if argument.startswith("--")} <= options
    assert "warm" in commands


def test_one_port_everywhere():
    assert last("EXPOSE") == str(PORT)
    assert json.loads(last("CMD"))[-1] == str(PORT)
    assert f"127.0.0.1:{PORT}'" in last("HEALTHCHECK")
    assert service()["ports"] == [f"127.0.0.1:{PORT}:{PORT}"]


@pytest.mark.parametrize("status", [200, 503])
def test_the_health_check_asks_the_server_and_no_proxy(status):
    class Ready(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(status if self.path == "/readyz" else 404)
            self.end_headers()

        def log_message(self, *_): ...

    python, *arguments = json.loads(last("HEALTHCHECK").partition(" CMD ")[2])
    assert python == "python"
    with http.server.HTTPServer(("127.0.0.1", 0), Ready) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        command = [argument.replace(str(PORT), str(server.server_port)) for argument in arguments]
        nowhere = os.environ | {"http_proxy": "http://127.0.0.1:1", "no_proxy": ""}
        ended = subprocess.run([sys.executable, *command], env=nowhere, timeout=60, check=False)
        server.shutdown()
        thread.join()
    assert ended.returncode == (status != 200)


def test_compose_lets_requests_in_flight_finish():
    seconds = int(service()["stop_grace_period"].removesuffix("s"))
    assert GRACE_SECONDS < seconds <= 2 * GRACE_SECONDS


def test_the_workers_fit_the_limits_of_compose():
    workers = int(service()["environment"]["CHUNKSERVER_WORKERS"])
    assert 1 <= workers <= service()["pids_limit"] // 8, "each is a process, and the others have threads"


def test_compose_knows_the_settings_and_what_may_go_without_keys():
    alone = settings_of(service())
    assert alone.insecure
    assert all(port.startswith("127.0.0.1:") for port in service()["ports"])
    assert str(alone.data) == "/var/lib/chunkserver"


def test_with_keys_nothing_is_insecure(tmp_path, monkeypatch):
    composed = service("compose.keys.yaml")
    (secret,) = composed["secrets"]
    assert Path(composed["environment"]["CHUNKSERVER_CONFIG"]) == Path("/run/secrets") / secret
    assert compose("compose.keys.yaml")["secrets"][secret] == {"file": secret}
    (tmp_path / secret).write_text(f'api_keys = ["{mint("game", "edit")[1]}"]')
    composed["environment"]["CHUNKSERVER_CONFIG"] = str(tmp_path / secret)
    chosen = settings_of(service(), composed)
    assert len(chosen.api_keys) == 1
    assert chosen.anonymous_read
    assert not chosen.insecure
    ignored = (DOCKER.parent / ".gitignore").read_text().splitlines()
    assert f"/docker/{secret}" in ignored
    monkeypatch.setitem(os.environ, "CHUNKSERVER_TYPO", "1")
    with pytest.raises(BadSetting):
        settings_of(service())


def test_compose_gives_no_privileges():
    settings = service()
    assert settings["read_only"] is True
    assert settings["cap_drop"] == ["ALL"]
    assert settings["security_opt"] == ["no-new-privileges:true"]
    assert settings["mem_limit"]
    assert settings["pids_limit"]
    assert not {"privileged", "cap_add", "network_mode", "pid", "user", "devices"} & settings.keys()


def test_compose_leaves_writable_only_what_must_be():
    writable = [*service()["tmpfs"], *(volume.split(":")[1] for volume in service()["volumes"])]
    assert writable == ["/tmp", "/var/cache/chunkserver", "/var/lib/chunkserver"]
    assert "CHUNKSERVER_CACHE_DIR=/var/cache/chunkserver" in last("ENV")
    assert "CHUNKSERVER_DATA=/var/lib/chunkserver" in last("ENV")
    for folder in writable[1:]:
        owned = [line for name, line in instructions() if name == "RUN" and "--owner=chunkserver" in line]
        assert folder in owned[0].split(), "a new volume has the owner of the folder that it covers"


def test_compose_builds_this_dockerfile():
    build = service()["build"]
    assert (DOCKER / build["context"] / build["dockerfile"]).samefile(DOCKERFILE)
