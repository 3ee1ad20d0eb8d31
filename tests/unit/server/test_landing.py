import re

import pytest

from chunkserver.recipe import BUILTINS
from tests.unit.server.stub import StubPool, client_of


@pytest.fixture(scope="module")
def client():
    with client_of(StubPool()) as client:
        yield client


def test_every_link_and_every_curl_line_works(client):
    page = client.get("/about").text
    links = re.findall(r'href="(/[^"]*)"', page)
    curls = re.findall(r'curl .*?"?http://testserver(/[^"\s<]*)', page)
    assert len(links) >= 4
    assert len(curls) == page.count("curl ") >= 3
    for url in links + curls:
        assert client.get(url).status_code == 200, url


def test_every_recipe_is_listed(client):
    page = client.get("/about").text
    for name in BUILTINS:
        assert f'"/v1/recipes/{name}"' in page


def test_it_needs_nothing_from_elsewhere(client):
    page = client.get("/about").text
    assert not re.search(r'(src|href)="(?!/|data:,)', page)
    assert "@import" not in page
    assert "url(" not in page


@pytest.mark.parametrize("host", ['"><script>alert(1)</script>', "a&copy;b", "'onclick='b"])
def test_a_host_cannot_write_on_the_page(client, host):
    page = client.get("/about", headers={"Host": host}).text
    assert host not in page
    assert "<script" not in page
