"""The mapping of bricks: as a dict is, and those before stay as they were."""

from chunkserver.edits import shared_map
from chunkserver.edits.shared_map import SharedMap


def test_every_version_is_what_a_dict_would_be(rng, monkeypatch):
    monkeypatch.setattr(shared_map, "PARTS", 7)
    versions: list[tuple[SharedMap[int, int], dict[int, int]]] = [(SharedMap(), {})]
    for _ in range(60):
        now, twin = versions[int(rng.integers(len(versions)))]
        keys, values = rng.integers(0, 50, (2, 20)).tolist()
        changes = {key: value if value < 35 else None for key, value in zip(keys, values, strict=True)}
        after = {key: value for key, value in (twin | changes).items() if value is not None}
        versions.append((now.changed(changes), after))
    for now, twin in versions:
        assert dict(now) == twin
        assert len(now) == len(twin)
        assert [now.get(key) for key in range(50)] == [twin.get(key) for key in range(50)]
    assert max(len(twin) for _, twin in versions) > 20


def test_what_has_not_changed_is_shared():
    nothing: SharedMap[int, int] = SharedMap()
    first = nothing.changed({key: key for key in range(10_000)})
    second = first.changed({5: 0, 6: None})
    assert sum(a is not b for a, b in zip(first._parts, second._parts, strict=True)) == 2
