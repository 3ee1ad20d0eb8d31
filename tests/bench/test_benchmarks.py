"""Every benchmark once at a tiny size: that it runs and what shape its results have, never how long anything took."""

import json
import math
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks import noise, peer_noise, pictures, whole
from benchmarks.jobs import JOBS
from benchmarks.measure import TINY, Figure, Line
from benchmarks.report import MARK
from benchmarks.scenes import SCENES, prepare
from benchmarks.seams import PLACES, cut_requests
from benchmarks.service import FIGURES
from benchmarks.skipping import FLIGHTS
from benchmarks.targets import TARGETS, Target, met

ROOT = Path(__file__).parents[2]
RUN_SECONDS_MAX = 600
PICTURE_BYTES_MAX = 100_000
MAY_BE_ZERO = {"triangles", "empty", "refused", "lost", "most within 25 ms", "long tasks"}
AT_SCALE = {"1,000,000 strokes": f"{TINY.log_strokes} strokes"}
"""Subjects of targets that a tiny run has in small."""
SEAMS = ("plain", "one face", "six faces", "skirts")
COUNTS = {"triangles", "triangles of the peer", "empty", "masked", *(f"triangles, {seam}" for seam in SEAMS)}
OPEN_SIMPLEX = {"simplex 2-D (OpenSimplex2)", "simplex 3-D (OpenSimplex2)"}


@dataclass(frozen=True)
class Run:
    printed: str
    page: str
    results: dict[str, Any]
    pictures: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    """One run of the command, all jobs, with everything that it writes."""
    folder = tmp_path_factory.mktemp("bench")
    page, results, drawn = folder / "page.md", folder / "results.json", folder / "drawn"
    page.write_text(f"Said by hand.\n\n{MARK}\n\nAn older run.\n")
    command = [sys.executable, "-m", "benchmarks", "--tiny", "--json", results, "--page", page, "--pictures", drawn]
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=RUN_SECONDS_MAX)
    return Run(done.stdout, page.read_text(), json.loads(results.read_text()), drawn)


def lines_of(run: Run, job: str) -> dict[str, dict[str, dict[str, Any]]]:
    """Return subject -> name of figure -> figure."""
    (found,) = [one for one in run.results["jobs"] if one["name"] == job]
    return {line["subject"]: {figure["name"]: figure for figure in line["figures"]} for line in found["lines"]}


def figures_of(run: Run) -> list[dict[str, Any]]:
    return [figure for job in run.results["jobs"] for line in job["lines"] for figure in line["figures"]]


def test_all_jobs_run(run):
    assert [job["name"] for job in run.results["jobs"]] == list(JOBS)


def test_every_figure_is_a_number_with_its_spread(run):
    for figure in figures_of(run):
        assert figure["rounds"], figure
        assert all(math.isfinite(value) for value in figure["rounds"]), figure
        assert all(value > 0 for value in figure["rounds"]) or figure["name"] in MAY_BE_ZERO, figure
        assert min(figure["rounds"]) <= figure["low"] <= figure["median"] <= figure["high"] <= max(figure["rounds"])


def test_ratios_are_taken_round_by_round(run):
    for job in ("extraction", "noise", "whole", "tape", "skipping", "seams"):
        for figures in lines_of(run, job).values():
            ours = figures["plain" if job == "seams" else "chunkserver"]
            assert ours["ratio"] is None
            peers = [figure for name, figure in figures.items() if name not in {ours["name"], *COUNTS}]
            assert peers
            for peer in peers:
                pairs = zip(peer["rounds"], ours["rounds"], strict=True)
                assert peer["ratios"] == pytest.approx([theirs / own for theirs, own in pairs])


def test_stages_and_peers_for_every_scene(run):
    stages, extraction = lines_of(run, "stages"), lines_of(run, "extraction")
    assert set(stages) == set(extraction) == set(SCENES)
    assert all({"field", "mesh, normals", "encode native", "encode GLB"} < set(line) for line in stages.values())
    assert all("vtkFlyingEdges3D" in line for line in extraction.values())
    with_skimage = {scene for scene, line in extraction.items() if "skimage lewiner" in line}
    assert with_skimage == set(SCENES) - {"empty air"}


def test_borders_are_measured_on_the_same_chunks(run):
    seams = lines_of(run, "seams")
    for scene in PLACES:
        whole_chunk = seams[f"{scene.name}: whole chunk"]
        counts = [whole_chunk[f"triangles, {seam}"]["median"] for seam in SEAMS]
        assert counts == sorted(counts)
        assert counts[0] < counts[2]
    for flight in FLIGHTS:
        plain, masked = cut_requests(flight, 8)
        assert plain == [replace(each, coarser=0) for each in masked]
        assert len({each.key for each in plain}) == 8
        assert any(each.coarser for each in masked)
        assert max(each.coarser.bit_count() for each in masked) <= 3


def test_scenes_are_what_they_say():
    for scene in SCENES.values():
        chunks = prepare(scene, TINY.chunks)
        assert len({chunk.request.key for chunk in chunks}) == TINY.chunks
        assert {chunk.mesh.content for chunk in chunks} == {scene.content}


def test_answers_are_the_expected_ones(run):
    service = lines_of(run, "service")
    assert all(set(line) == {name for name, _ in FIGURES} for line in service.values())
    kilobytes = {subject: line["answer"]["median"] for subject, line in service.items()}
    assert all((size < 1) == subject.startswith("304") for subject, size in kilobytes.items())
    assert all(line["empty"]["median"] == 0 for subject, line in service.items() if subject.startswith(("warm", "304")))


def test_a_missing_peer_leaves_our_figures_alone(monkeypatch):
    monkeypatch.setattr(peer_noise, "_library", None)
    for line in noise.run(TINY):
        others = ["opensimplex"] if line.subject in OPEN_SIMPLEX else []
        assert [figure.name for figure in line.figures] == ["chunkserver", *others]
    (line,) = whole.run(TINY)
    assert [figure.name for figure in line.figures] == ["triangles", "chunkserver"]


def test_page_and_print_are_the_same_but_for_pictures(run):
    above, _, below = run.page.partition(MARK)
    assert above == "Said by hand.\n\n"
    assert [line for line in below.split("\n") if line and line[0] != "!"] == [*filter(None, run.printed.split("\n"))]


def test_pictures_stand_on_the_page(run):
    links = [line for line in run.page.splitlines() if line.startswith("![")]
    assert links == [pictures.link(job, f"drawn/{job}.svg") for job in JOBS if job in pictures.PICTURES]
    assert {path.stem for path in run.pictures.iterdir()} == set(pictures.PICTURES) <= set(JOBS)


def test_the_same_run_draws_the_same_bytes(run, tmp_path):
    again = pictures.draw(run.results, tmp_path)
    assert len(again) == len(pictures.PICTURES)
    for path in again.values():
        assert path.read_bytes() == (run.pictures / path.name).read_bytes()
        assert b"<text" in path.read_bytes(), "text stays text"
        assert path.stat().st_size < PICTURE_BYTES_MAX


def test_every_target_has_its_figure(run):
    for target in TARGETS:
        figure = lines_of(run, target.job)[AT_SCALE.get(target.subject, target.subject)][target.figure]
        assert figure["unit"] == target.unit if target.unit else figure["ratio"], target
    shown = run.printed.partition("## Targets")[2]
    measured = [target for target in TARGETS if target.subject not in AT_SCALE]
    assert sum(line.startswith("| ") for line in shown.splitlines()) == 2 + len(measured)


def test_a_target_is_reached_from_its_figure_on():
    lines = [Line("here", (Figure("peer", "ms", (6.0, 4.0), (3.0, 2.0)),))]
    at_least, at_most = Target("job", "here", "peer", 2, 3), Target("job", "here", "peer", 0.5, 0.4, at_most=True)
    assert at_least.reached(lines) == 2.5
    assert at_most.reached(lines) == pytest.approx((1 / 3 + 1 / 2) / 2)
    assert [at_least.verdict(times) for times in (1.9, 2, 3)] == ["", "must", "aim"]
    assert [at_most.verdict(times) for times in (0.6, 0.5, 0.4)] == ["", "must", "aim"]
    ours = Target("job", "here", "peer", 2.5, 2, at_most=True, ours=True)
    assert (ours.reached(lines), ours.verdict(2.5), ours.verdict(2.6)) == (2.5, "must", "")
    itself = Target("job", "here", "peer", 5, 4, at_most=True, unit="ms")
    assert (itself.reached(lines), itself.verdict(5.0), itself.verdict(5.1)) == (5.0, "must", "")
    most = Target("job", "here", "peer", 4, 6, unit="ms")
    assert (most.reached(lines), most.verdict(5.0)) == (5.0, "must")
    assert Target("job", "there", "peer", 2, 3).reached(lines) is None
    assert met({"another": lines}) == []


def test_tables_are_rectangular(run):
    for section in run.printed.split("## ")[2:]:
        rows = [line for line in section.splitlines() if line.startswith("|")]
        assert len(rows) > 2, section
        assert len({row.count("|") for row in rows}) == 1, section


def test_machine_is_named(run):
    assert {"date", "commit", "cpu", "cores", "load before the run", "python", "numba"} <= set(run.results["machine"])
