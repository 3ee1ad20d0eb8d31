"""What is to be reached: how many times a figure of the same run, or, where time itself is promised, what figure."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from benchmarks.measure import Line, spread


class Target(NamedTuple):
    """How many times its peer's figure one of ours is to be; or what it is to be itself.

    job, subject, figure: where the peer's figure stands. must, aim: times, or in `unit`.
    at_most: ours may be at most so many times the peer's; otherwise the peer's is to be at least so many times ours.
    ours: the figure is not a peer's but ours, and may be at most so many times the first of its line.
    unit: of a figure that stands for itself; "" if it is compared.
    """

    job: str
    subject: str
    figure: str
    must: float
    aim: float
    at_most: bool = False
    ours: bool = False
    unit: str = ""

    def reached(self, lines: Sequence[Line]) -> float | None:
        """Return the median of what was measured, or None if it was not."""
        found = [
            figure.rounds if self.unit else figure.ratios
            for line in lines
            for figure in line.figures
            if (line.subject, figure.name) == (self.subject, self.figure)
        ]
        upside_down = self.at_most and not (self.ours or self.unit)
        return spread([1 / value if upside_down else value for value in found[0]]).median if found else None

    def verdict(self, reached: float) -> str:
        """Return which of the two it reaches: `aim`, `must` or neither."""
        sign = -1 if self.at_most else 1
        if sign * reached >= sign * self.aim:
            return "aim"
        return "must" if sign * reached >= sign * self.must else ""


_CAVES: Final = "terrain underground"

TARGETS: Final = (
    Target("extraction", _CAVES, "vtkFlyingEdges3D", 3.1, 4.5),
    Target("extraction", "terrain surface", "vtkFlyingEdges3D", 2.8, 4),
    Target("extraction", _CAVES, "skimage lewiner", 13, 18),
    Target("extraction", _CAVES, "PyMCubes", 9, 12),
    Target("extraction", "empty air", "vtkFlyingEdges3D", 12, 20),
    Target("noise", "simplex 3-D (OpenSimplex2)", "pyfastnoiselite", 8, 12),
    Target("noise", "simplex 3-D (OpenSimplex2)", "opensimplex", 17, 25),
    Target("noise", "fbm 2-D, 5 octaves (Perlin)", "pyfastnoiselite", 6, 9),
    Target("whole", _CAVES, "pyfastnoiselite + skimage", 12, 25),
    Target("skipping", "fly-through, terrain", "every sample", 1.3, 2),
    Target("skipping", "fly-through, hills", "every sample", 3, 6),
    Target("skipping", "fly-through, planet", "every sample", 3, 6),
    Target("skipping", "proved air", "every sample", 60, 100),
    Target("tape", "terrain", "by hand", 1.15, 1.0, at_most=True),
    Target("tape", "50 nodes of solids", "by hand", 2.5, 1.5, at_most=True),
    *(
        Target("seams", f"{place}: whole chunk", "six faces", 1.5, 1.3, at_most=True, ours=True)
        for place in ("terrain surface", "caves", "planet")
    ),
    *(Target("levels", world, "LOD 0", 1.2, 1.0, at_most=True) for world in ("terrain", "hills", "planet")),
    Target("cores", _CAVES, "two processes", 1.85, 1.95),
    *(
        Target("edited", "its deltas", f"deltas added, {kind}", 0.1, 0.05, at_most=True, ours=True)
        for kind in ("with a carve", "with all bricks")
    ),
    Target("editing", "1,000 carves a second, 1 an edit", "99 %", 25, 10, at_most=True, unit="ms"),
    Target("editing", "1,000 carves a second, 10 an edit", "99 %", 25, 10, at_most=True, unit="ms"),
    Target("editing", "carves, 1 an edit", "most within 25 ms", 1000, 2000, unit="1/s"),
    Target("editing", "adds, 100 an edit", "acknowledged and folded", 10_000, 20_000, unit="strokes/s"),
    Target("editing", "a carve, then its chunks", "visible, median", 40, 15, at_most=True, unit="ms"),
    Target("stream", "100 edits a second, 100 listeners", "from ack, 99 %", 80, 30, at_most=True, unit="ms"),
    Target("stream", "32 editors", "acknowledged", 250, 1000, unit="1/s"),
    Target("stream", "500 come back", "all caught up", 5, 1, at_most=True, unit="s"),
    Target("replay", "1,000,000 strokes", "first edited chunk", 5, 3, at_most=True, unit="s"),
    Target("viewer", "page", "compressed", 400, 200, at_most=True, unit="kB"),
    Target("viewer", "fly-through, terrain", "95 %", 4, 2, at_most=True, unit="ms a frame"),
    Target("viewer", "fly-through, terrain", "long tasks", 0, 0, at_most=True, unit="tasks"),
)


def met(results: Mapping[str, Sequence[Line]]) -> list[tuple[Target, float]]:
    """Return the targets of the jobs that were run, by name, each with what was reached."""
    found = [(target, target.reached(results.get(target.job, ()))) for target in TARGETS]
    return [(target, reached) for target, reached in found if reached is not None]
