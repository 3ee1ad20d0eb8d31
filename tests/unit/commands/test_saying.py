import re
import sys

from chunkserver.commands import saying


def test_a_table_is_a_line_each_for_scripts(capsys):
    saying.say_table(("name", "what"), [("a", "long " * 40), ("bcdefg", "")])
    assert capsys.readouterr().out.splitlines() == ["name    what", "a       " + ("long " * 40).rstrip(), "bcdefg"]


def test_a_table_on_a_terminal_is_wrapped(capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "40")
    saying.say_table(("name", "what"), [("[a]", "long " * 40)])
    lines = re.sub(r"\x1b\[\d*m", "", capsys.readouterr().out).splitlines()
    assert len(lines) > 4
    assert max(map(len, lines)) <= 40
    assert lines[1].startswith("[a]")


def test_a_bar_yields_what_it_is_given(capsys, monkeypatch):
    assert list(saying.with_bar("chunks", iter("abc"), 3)) == ["a", "b", "c"]
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(saying.with_bar("chunks", iter("abc"), 3)) == ["a", "b", "c"]
    said = capsys.readouterr()
    assert "chunks" in said.err
    assert said.out == ""


def test_counted():
    assert [saying.counted(count, "chunk") for count in (0, 1, 2000)] == ["0 chunks", "1 chunk", "2,000 chunks"]
