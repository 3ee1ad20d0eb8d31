"""The page and what it names: cached for ever or asked about, compressed, and held to its own scripts."""

import gzip
import re

from fastapi.testclient import TestClient

from chunkserver.server import create_app
from chunkserver.server.access import NEEDS, Table
from chunkserver.server.settings import Settings
from chunkserver.server.viewer import FOLDER

CLIENT = TestClient(create_app(Settings()))
PAGE = (FOLDER / "index.html").read_text(encoding="utf-8")
NAMED = re.findall(r'(?:src|href)="\./(assets/[^"]+)"', PAGE)


def test_the_page_is_asked_about_and_what_it_names_is_not():
    assert len(NAMED) == 2
    for path, control in (("", "no-cache"), *((name, "public, max-age=31536000, immutable") for name in NAMED)):
        answer = CLIENT.get(f"/{path}")
        assert answer.status_code == 200
        assert answer.headers["cache-control"] == control
        assert answer.content == (FOLDER / (path or "index.html")).read_bytes()
        again = CLIENT.get(f"/{path}", headers={"If-None-Match": answer.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")


def test_each_coding_has_a_tag_of_its_own():
    plain, small = (CLIENT.get("/", headers={"Accept-Encoding": coding}) for coding in ("identity", "gzip, br"))
    assert "content-encoding" not in plain.headers
    assert small.headers["content-encoding"] == "gzip"
    assert plain.headers["etag"] != small.headers["etag"]
    assert plain.headers["vary"] == small.headers["vary"] == "Accept-Encoding"
    assert int(small.headers["content-length"]) < len(gzip.compress(plain.content)) + 64 < len(plain.content)


def test_only_scripts_of_its_own_run():
    policy = CLIENT.get("/").headers["content-security-policy"]
    assert "default-src 'none'; script-src 'self';" in policy
    assert "unsafe" not in policy
    assert not re.findall(r"<script(?![^>]* src=)|<style| style=| on[a-z]+=", PAGE)


def test_there_is_nothing_else():
    for path in ("/assets/nothing.js", "/assets/..%2Findex.html", "/assets/", "/index.html"):
        assert CLIENT.get(path).status_code == 404, path


def test_the_page_needs_no_key():
    table = Table(NEEDS)
    assert [table.row("GET", path).scope for path in ("/", f"/{NAMED[0]}")] == [None, None]
    assert table.row("GET", "/about").scope is not None
