"""What all tests share: the folder of compiled code, the random seeds, and the table of the time each folder took."""

import os
import secrets
import zlib
from collections import defaultdict
from pathlib import Path

import hypothesis
import numpy as np
import pytest

from tests import scale

CACHE = Path(__file__).parents[1] / ".cache"
# Read when chunkserver is imported, so it stands here and not in a fixture. Kept between runs: compiling takes longer
# than most tests, and the folder is keyed by a digest of the sources, so nothing stale can come back.
os.environ.setdefault("CHUNKSERVER_CACHE_DIR", str(CACHE / "compiled"))
os.environ.setdefault("HYPOTHESIS_STORAGE_DIRECTORY", str(CACHE / "hypothesis"))

SEED = int(os.environ.get("CHUNKSERVER_TEST_SEED") or secrets.randbits(32))

for variable in ("CHUNKSERVER_TEST_SEED", "CHUNKSERVER_TORTURE"):
    os.environ.pop(
        variable, None
    )  # a server that is started here knows neither, and takes no variable that it does not

hypothesis.settings.register_profile(
    "chunkserver",
    deadline=None,  # the first example may compile a kernel
    max_examples=scale.count(10_000),
    print_blob=True,
)
hypothesis.settings.load_profile("chunkserver")


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A generator of this test's own: the same for the same session seed, whichever tests run before it."""
    return np.random.default_rng([SEED, zlib.crc32(request.node.nodeid.encode())])


def pytest_report_header() -> list[str]:
    return [f"CHUNKSERVER_TEST_SEED={SEED}", f"size: {'torture' if scale.TORTURE else '1 % of torture'}"]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    report = yield
    if report.failed and "rng" in item.fixturenames:
        report.sections.append(("random seed", f"run again with CHUNKSERVER_TEST_SEED={SEED}"))
    return report


def pytest_terminal_summary(terminalreporter) -> None:
    seconds: dict[str, float] = defaultdict(float)
    tests: dict[str, set[str]] = defaultdict(set)
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport):  # one each for set-up, call and tear-down
                folder = report.nodeid.split("/")[1]
                seconds[folder] += report.duration
                tests[folder].add(report.nodeid)
    terminalreporter.section("time by folder")
    for folder in sorted(seconds, key=lambda folder: -seconds[folder]):
        terminalreporter.write_line(f"{folder:<12} {len(tests[folder]):6} tests {seconds[folder]:8.1f} s")
    total = sum(map(len, tests.values()))
    terminalreporter.write_line(f"{'total':<12} {total:6} tests {sum(seconds.values()):8.1f} s")
