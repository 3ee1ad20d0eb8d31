"""A disk under SQLite that remembers what it was never told to sync: for losses of power, and for faults on demand.

    with Disk(fault) as disk:          every connection that is opened meanwhile writes through it
        ...
        image = disk.after_power_loss(rng)     or disk.after_kill()

What was synced is there after a loss of power. Of what was written since, each sector is there, or is not, or is there
in part, in no order; of files that came or went without a sync of their folder, likewise. A process that is killed
leaves all that it has written, but what it had not synced may be lost later still.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path

import apsw
import numpy as np

SECTORS = (512, 4096)
NAME = "disk"
UNDER = "unix"
JOURNALS = apsw.SQLITE_OPEN_WAL | apsw.SQLITE_OPEN_MAIN_JOURNAL

Fault = Callable[[str, str], None]
"""Is told of each operation (write, truncate, sync, delete) and its file before it is done, and may raise; and of each
sync that is done (synced)."""


@dataclass
class Content:
    """What a file has on the disk, and in order what was written since: (place, bytes), or (length, None) for a cut."""

    synced: bytes = b""
    since: list[tuple[int, bytes | None]] = field(default_factory=list)

    @property
    def whole(self) -> bytes:
        """What a process reads in it."""
        kept = bytearray(self.synced)
        for place, written in self.since:
            change(kept, place, written)
        return bytes(kept)

    def sync(self) -> None:
        self.synced, self.since = self.whole, []

    def torn(self, rng: np.random.Generator) -> bytes:
        """Return what may be left of it without power."""
        kept = bytearray(self.synced)
        share = rng.choice([0.0, 0.1, 0.5, 0.9, 1.0])
        sector = int(rng.choice(SECTORS))
        for place, written in self.since:
            if written is None:
                if rng.random() < share:
                    change(kept, place, None)
                continue
            for start in range(0, len(written), sector):
                part = written[start : start + sector]
                if rng.random() < share:
                    whole = rng.random() < 0.9
                    change(kept, place + start, part if whole else part[: int(rng.integers(len(part)))])
        return bytes(kept)


def change(kept: bytearray, place: int, written: bytes | None) -> None:
    if written is None:
        del kept[place:]
    else:
        kept.extend(bytes(max(0, place - len(kept))))
        kept[place : place + len(written)] = written


@dataclass
class Image:
    """The files in the folder, by name; and those that are there without power too."""

    entries: dict[str, Content] = field(default_factory=dict)
    durable_entries: dict[str, Content] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        for name, content in self.entries.items():
            (folder / name).write_bytes(content.whole)


class Disk(apsw.VFS):
    """The default file system of SQLite while the block lasts.

    fault: see there.
    image: what the files have at the start; they must be there already.
    synced: whether a sync goes on to the real disk too.
    """

    def __init__(self, fault: Fault = lambda *_: None, image: Image | None = None, synced: bool = False) -> None:
        self.fault, self.synced = fault, synced
        found = deepcopy(image or Image())
        self.entries, self.durable_entries = found.entries, found.durable_entries
        super().__init__(NAME, UNDER, makedefault=True)

    def __enter__(self) -> "Disk":
        return self

    def __exit__(self, *_: object) -> None:
        self.unregister()

    def xOpen(self, name: apsw.URIFilename | str | None, flags: list[int]) -> apsw.VFSFile:  # noqa: N802
        return _File(self, name, flags)

    def xDelete(self, name: str, sync_folder: bool) -> None:  # noqa: N802
        self.fault("delete", Path(name).name)
        super().xDelete(name, sync_folder)
        self.entries.pop(Path(name).name, None)
        if sync_folder:
            self.sync_folder()

    def sync_folder(self) -> None:
        self.durable_entries = dict(self.entries)

    def after_power_loss(self, rng: np.random.Generator) -> Image:
        """Return what is in the folder when the power is back."""
        left = {}
        for name in sorted({*self.entries, *self.durable_entries}):
            entries = self.entries if rng.random() < 0.5 else self.durable_entries
            if name in entries:
                left[name] = Content(entries[name].torn(rng))
        return Image(left, left)

    def after_kill(self) -> Image:
        """Return what is in the folder when the process is gone."""
        return deepcopy(Image(self.entries, self.durable_entries))


class _File(apsw.VFSFile):
    def __init__(self, disk: Disk, name: apsw.URIFilename | str | None, flags: list[int]) -> None:
        path = name.filename() if isinstance(name, apsw.URIFilename) else str(name)
        self.disk, self.name, self.may_be_new = disk, Path(path).name, bool(flags[0] & JOURNALS)
        super().__init__(UNDER, name, flags)
        if name is not None and self.name not in disk.entries:
            disk.entries[self.name] = Content()
        self.content = disk.entries.get(self.name, Content())

    def xWrite(self, written: bytes, place: int) -> None:  # noqa: N802
        self.disk.fault("write", self.name)
        super().xWrite(written, place)
        self.content.since.append((place, bytes(written)))

    def xTruncate(self, length: int) -> None:  # noqa: N802
        self.disk.fault("truncate", self.name)
        super().xTruncate(length)
        self.content.since.append((length, None))

    def xSync(self, flags: int) -> None:  # noqa: N802
        """As SQLite's own does, sync the folder too at the first sync of a journal that was opened, new or not."""
        self.disk.fault("sync", self.name)
        if self.disk.synced:
            super().xSync(flags)
        self.content.sync()
        if self.may_be_new:
            self.may_be_new = False
            self.disk.sync_folder()
        self.disk.fault("synced", self.name)
