"""What the figures were measured on."""

import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from benchmarks.measure import Scale

ROOT: Final = Path(__file__).parents[1]
PACKAGES: Final = (
    "numba",
    "llvmlite",
    "numpy",
    "vtk",
    "scikit-image",
    "pymcubes",
    "pyfastnoiselite",
    "opensimplex",
    "fastapi",
    "uvicorn",
    "uvloop",
)

VECTORS: Final = ("avx512f", "avx2", "avx")


def facts(scale: Scale) -> Mapping[str, str]:
    """Return names and values of what the figures depend on, the load that others put on the machine included."""
    return {
        "scale": f"{scale.chunks} chunks in rotation, {scale.rounds} rounds",
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": _commit(),
        "cpu": _cpu(),
        "cores": str(len(os.sched_getaffinity(0))),
        "load before the run": f"{os.getloadavg()[0]:.2f}",
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        **{package: _version(package) for package in PACKAGES},
    }


def _cpu() -> str:
    """Return the CPU's name and the widest vectors that it has."""
    lines = [line.partition(":") for line in Path("/proc/cpuinfo").read_text().splitlines()]
    first = {name.strip(): value.strip() for name, _, value in reversed(lines)}
    vectors = [name for name in VECTORS if name in first.get("flags", "").split()]
    return f"{first.get('model name', platform.machine())}, {vectors[0] if vectors else 'no AVX'}"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _commit() -> str:
    commit = _git("rev-parse", "--short=12", "HEAD")
    return f"{commit} and uncommitted changes" if _git("status", "--porcelain", "chunkserver") else commit


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip()
