"""How the server starts and stops: signals, ports, exit codes, its log."""

import signal
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import httpx2
import pytest

from chunkserver import __version__
from tests.serving import SERVE, serving, until

WAITING = ("-m", "tests.contract.waiting_server")
CHUNK = "/v1/seeds/1/chunks/0/0/0/0"
SECONDS_MAX = 20.0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stop_answers_what_is_in_flight(tmp_path, number):
    released = tmp_path / "released"
    with serving(tmp_path / "log", str(released), program=WAITING) as server, ThreadPoolExecutor() as threads:
        answer = threads.submit(httpx2.get, server.url + CHUNK, timeout=SECONDS_MAX)
        until(lambda: "building" in server.log.read_text(), SECONDS_MAX)
        server.child.send_signal(number)
        until(lambda: not accepts(server.url), SECONDS_MAX)
        assert not answer.done()
        released.touch()
        assert (answer.result().status_code, answer.result().content) == (200, b"built")
        assert server.child.wait(SECONDS_MAX) == 0
        assert "closed" in server.log.read_text()


def accepts(url):
    host, port = url.removeprefix("http://").split(":")
    try:
        socket.create_connection((host, int(port)), timeout=SECONDS_MAX).close()
    except OSError:
        return False
    return True


def test_a_stop_while_kernels_compile(tmp_path, monkeypatch):
    monkeypatch.setenv("CHUNKSERVER_CACHE_DIR", str(tmp_path / "compiled"))
    with serving(tmp_path / "log", ready=False) as server:
        assert httpx2.get(f"{server.url}/livez").status_code == 200
        early = httpx2.get(f"{server.url}/readyz")
        assert (early.status_code, early.json()["type"]) == (503, "urn:chunkserver:problem:unavailable")
        assert int(early.headers["retry-after"]) > 0
        assert server.stop() == 0


def test_a_connection_that_says_nothing_does_not_hold_up_a_stop(tmp_path):
    with serving(tmp_path / "log", str(tmp_path / "never"), program=WAITING) as server:
        host, port = server.url.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port))) as silent:
            silent.sendall(b"GET / HTTP/1.1\r\nHost: x\r\n")
            assert server.stop() == 0


@pytest.mark.parametrize("path", [CHUNK, "/openapi.json"], ids=["is not answered", "does not read"])
def test_a_client_that_holds_the_stop_is_worth_one_line(tmp_path, path):
    log = tmp_path / "log"
    with pytest.raises(AssertionError, match="1 lines of the log are not clean"):
        stop_with_a_client(log, path)
    assert "graceful shutdown exceeded" in log.read_text()


def stop_with_a_client(log, path):
    with serving(log, str(log.with_name("never")), "1", '{"pipelined_max": 500}', program=WAITING) as server:
        host, port = server.url.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port))) as client:
            client.sendall(f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode() * 500)
            until(lambda: "building" in log.read_text() if path == CHUNK else client.recv(1), SECONDS_MAX)
            assert server.stop() == 0


def test_an_unexpected_fault_is_a_500_and_its_cause_is_in_the_log(tmp_path):
    log = tmp_path / "log"
    with pytest.raises(AssertionError, match="of the log are not clean"):  # which shows that the check can fail
        run_into_a_fault(log)
    assert log.read_text().count("ValueError: a fault of the server") == 1


def run_into_a_fault(log):
    with serving(log, str(log.with_name("never")), program=WAITING) as server:
        answer = httpx2.get(f"{server.url}/v1/seeds/-1/chunks/0/0/0/0")
    assert (answer.status_code, answer.headers["content-type"]) == (500, "application/problem+json")
    assert "fault" not in answer.text


def test_the_log_says_where_it_listens_and_where_worlds_are(tmp_path):
    with serving(tmp_path / "log", str(tmp_path / "never"), program=WAITING) as server:
        first, second, *others = server.log.read_text().splitlines()
        assert not others
        assert server.url in first
        assert __version__ in first
        assert "compiled" in first
        assert "in memory" in second
        assert "--data" in second


def test_a_port_that_is_taken():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        command = [sys.executable, *SERVE[:-1], str(taken.getsockname()[1])]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS_MAX, check=False)
    assert ended.returncode == 1
    assert command[-1] in ended.stderr
    assert "Traceback" not in ended.stderr
