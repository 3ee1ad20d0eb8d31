"""How long things are: docs/CONVENTIONS.md, "Names". A docstring counts: it is read, too."""

from collections.abc import Iterator

from tests.house.checkout import Function, functions, holds, nothing, texts

FILE_LINES_MAX = 400
FUNCTION_LINES_MAX = 70
FUNCTION_LINES_AT_90_PERCENT = 40
FUNCTION_LINES_AT_MEDIAN = 12


def lines(function: Function) -> int:
    return (function.end_lineno or function.lineno) - function.lineno + 1


def long_file(path: str, text: str) -> Iterator[str]:
    length = text.count("\n")
    if length > FILE_LINES_MAX:
        yield f"{path}:{FILE_LINES_MAX}: the file has {length} lines: at most {FILE_LINES_MAX}"


def long_functions(path: str, text: str) -> Iterator[str]:
    for function in functions(text):
        if lines(function) > FUNCTION_LINES_MAX:
            yield f"{path}:{function.lineno}: {function.name} has {lines(function)} lines: at most {FUNCTION_LINES_MAX}"


def long_quantiles(sources: dict[str, str]) -> list[str]:
    """Return which quantile of the function lengths is over its limit, with the functions that stand beyond it."""
    by_length = sorted(
        (lines(function), f"{path}:{function.lineno}: {function.name} has {lines(function)} lines")
        for path, text in sources.items()
        for function in functions(text)
    )
    wrong = []
    for percent, limit in ((50, FUNCTION_LINES_AT_MEDIAN), (90, FUNCTION_LINES_AT_90_PERCENT)):
        beyond = [where for length, where in by_length if length > limit]
        if 100 * len(beyond) > (100 - percent) * len(by_length):
            wrong.append("\n".join([f"{percent} % of the functions should have at most {limit} lines, but:", *beyond]))
    return wrong


def test_files_are_short():
    holds(long_file, "*.py", "*.ts")


def test_functions_are_short():
    holds(long_functions, "*.py")


def test_most_functions_are_very_short():
    nothing(long_quantiles(texts("chunkserver/*.py")))


def function_of(length: int) -> str:
    return "def f():\n" + "    pass\n" * (length - 1)


def test_finds_a_long_file():
    assert list(long_file("a.py", "\n" * (FILE_LINES_MAX + 1)))
    assert not list(long_file("a.py", "\n" * FILE_LINES_MAX))


def test_finds_a_long_function():
    assert list(long_functions("a.py", function_of(FUNCTION_LINES_MAX + 1))) == ["a.py:1: f has 71 lines: at most 70"]
    assert not list(long_functions("a.py", function_of(FUNCTION_LINES_MAX)))


def test_finds_a_house_of_long_functions():
    short, longer, long = map(function_of, (12, 13, 41))
    assert not long_quantiles({"a.py": short * 5 + longer * 4 + long})
    assert len(long_quantiles({"a.py": short * 4 + longer * 6})) == 1
    assert len(long_quantiles({"a.py": short * 8 + long * 2})) == 1
