import json
import re

from chunkserver.server import Settings
from tests.unit.commands.typed import run

DIGEST = "0" * 64


def test_config_show_says_every_value_and_its_origin(tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text("log_format = 'json'")
    key = f"a:read:{DIGEST}"
    options = ("config", "show", "--port", "1", "--config", str(file))
    told = json.loads(run(*options, "--json", CHUNKSERVER_API_KEYS=key).stdout)
    assert told.keys() == Settings.model_fields.keys()
    assert told["port"] == {"value": 1, "from": "--port"}
    assert told["api_keys"] == {"value": ["a:read:***"], "from": "CHUNKSERVER_API_KEYS"}
    assert told["log_format"] == {"value": "json", "from": f"log_format in {file}"}
    assert told["host"] == {"value": "127.0.0.1", "from": "default"}
    lines = run(*options, CHUNKSERVER_API_KEYS=key).stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(told)
    assert re.match(r'api_keys += \["a:read:\*\*\*"\]  # CHUNKSERVER_API_KEYS$', lines[list(told).index("api_keys")])
