"""Where the results of a sweep lie, cut into shards: in memory, or in a folder that outlives the process.

    record   results of some lanes as one structured array: a field for each output
    shard    the record of the lanes i chunk ... (i + 1) chunk - 1, fewer in the last one

A stored shard is one file, `shard-000012-9f86d081884c7d65.npy`: its number and the start of its SHA-256. Written beside its
place and renamed, it is there with its checksum or not at all, whenever the process is killed. The manifest says what the
sweep is.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from jaxsphere.files import write_atomically, write_json
from jaxsphere.simulation.sweeps.identity import fingerprint

FORMAT = 1
MANIFEST = "manifest.json"
RESUME = "resume the same sweep to go on (resume=True or --resume)"
_NAME = re.compile(r"shard-(\d{6,})-([0-9a-f]{16})\.npy")


class SweepError(RuntimeError):
    """A sweep could not go on, or its store cannot be read; what is done stays in the store."""


class Shards(Protocol):
    """What a sweep writes its records to and what its results read."""

    @property
    def lanes(self) -> int:
        """Of the whole sweep."""
        ...

    @property
    def chunk(self) -> int:
        """Lanes a shard."""
        ...

    def read(self, index: int) -> np.ndarray:
        """Record of one shard."""
        ...

    def write(self, index: int, record: np.ndarray) -> None:
        """Keep the record of one shard."""
        ...


@dataclass
class Memory:
    """Shards that live as long as the process."""

    lanes: int
    chunk: int
    records: dict[int, np.ndarray] = field(default_factory=dict)

    def read(self, index: int) -> np.ndarray:
        """Record of one shard."""
        return self.records[index]

    def write(self, index: int, record: np.ndarray) -> None:
        """Keep the record of one shard."""
        self.records[index] = record


@dataclass
class Store:
    """Shards in a folder. manifest: what `describe` made. verified: shards whose checksum was right when last read."""

    folder: Path
    manifest: dict[str, Any]
    verified: dict[int, Path] = field(default_factory=dict)

    @property
    def lanes(self) -> int:
        """Of the whole sweep."""
        return self.manifest["lanes"]

    @property
    def chunk(self) -> int:
        """Lanes a shard."""
        return self.manifest["chunk"]

    def read(self, index: int) -> np.ndarray:
        """Record of one shard, mapped into memory. Raises SweepError when it is missing or damaged."""
        if index not in self.verified and self.check([index]):
            raise SweepError(f"shard {index} of store = {str(self.folder)!r} is damaged; {RESUME}")
        if index not in self.verified:
            raise SweepError(f"shard {index} of store = {str(self.folder)!r} is missing; {RESUME}")
        return np.load(self.verified[index], mmap_mode="r", allow_pickle=False)

    def write(self, index: int, record: np.ndarray) -> None:
        """Write one shard atomically. Raises SweepError with one sentence when the folder cannot take it."""
        buffer = io.BytesIO()
        np.save(buffer, record, allow_pickle=False)
        data = buffer.getvalue()
        path = self.folder / f"shard-{index:06d}-{_checksum(data)}.npy"
        try:
            write_atomically(path, lambda temporary: _fill(temporary, data))
        except OSError as error:
            done = len(self.files())
            raise SweepError(
                f"store = {str(self.folder)!r} cannot take shard {index} ({error.strerror or error}); {done} of "
                f"{shard_count(self)} shards are safe: make room and {RESUME}"
            ) from None
        self.verified[index] = path

    def files(self) -> dict[int, list[Path]]:
        """Shard number -> the files that claim to be it."""
        found: dict[int, list[Path]] = {}
        for path in sorted(self.folder.iterdir()):
            if match := _NAME.fullmatch(path.name):
                found.setdefault(int(match[1]), []).append(path)
        return found

    def check(self, shards: Iterable[int]) -> list[int]:
        """Verify the files of these shards; return the numbers of those with a damaged file."""
        files, damaged = self.files(), []
        for index in shards:
            for path in files.get(index, []):
                if _is_whole(path):
                    self.verified[index] = path
                else:
                    damaged.append(index)
        return damaged

    def discard(self, shards: Iterable[int]) -> None:
        """Remove every file of these shards and count them as missing."""
        files = self.files()
        for index in shards:
            self.verified.pop(index, None)
            for path in files.get(index, []):
                path.unlink(missing_ok=True)

    def seal(self) -> None:
        """Add the checksums of all shards to the manifest of a complete store. Raises SweepError when a shard is missing."""
        files = self.files()
        missing = next((index for index in range(shard_count(self)) if index not in files), None)
        if missing is not None:
            raise SweepError(f"shard {missing} of store = {str(self.folder)!r} is missing; {RESUME}")
        sums = [path.stem.rpartition("-")[2] for index in range(shard_count(self)) for path in files[index]]
        self.manifest = self.manifest | {"checksums": sums}
        _write_manifest(self.folder, self.manifest)


def describe(spec: dict[str, Any], versions: dict[str, str], lanes: int, chunk: int, layout: np.dtype) -> dict[str, Any]:
    """Manifest of a store: what is swept, by which versions, into how many lanes a shard of which outputs."""
    outputs = {name: {"dtype": layout[name].base.str, "shape": list(layout[name].shape)} for name in layout.names or ()}
    spec = spec | {"outputs": outputs}
    content = {"format": FORMAT, "fingerprint": fingerprint(spec), "versions": versions, "lanes": lanes, "chunk": chunk}
    return content | {"spec": spec}


def create(store: Store) -> None:
    """Write the manifest of a new store. Raises SweepError when the folder cannot be written."""
    _write_manifest(store.folder, store.manifest)


def load(folder: Path) -> Store:
    """Open a store that is there. Raises ValueError when it is not, or of another format."""
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        number = manifest["format"]
    except FileNotFoundError:
        raise ValueError(f"store = {str(folder)!r} holds no sweep to resume; start it without resume") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"store = {str(folder)!r} has no readable {MANIFEST} ({error}); type another folder") from None
    if number != FORMAT:
        raise ValueError(f"store = {str(folder)!r} has format {number!r}, not {FORMAT}; type another folder")
    return Store(folder, manifest)


def require_empty(folder: Path) -> None:
    """Require that no sweep is in the folder. Raises ValueError otherwise."""
    if (folder / MANIFEST).exists():
        raise ValueError(f"store = {str(folder)!r} holds a sweep already; {RESUME}, or type another folder")
    if any(folder.glob("shard-*.npy")):
        raise ValueError(f"store = {str(folder)!r} holds shards without {MANIFEST}; type another folder")


def require_same(found: dict[str, Any], wanted: dict[str, Any], folder: Path) -> None:
    """Require that the store holds this very sweep, by these versions. Raises ValueError naming what differs."""
    if found["fingerprint"] != wanted["fingerprint"]:
        one, other = found["spec"], wanted["spec"]
        parts = ", ".join(key for key in sorted(one | other) if one.get(key) != other.get(key))
        raise ValueError(f"store = {str(folder)!r} is of another sweep (it differs in {parts}); type another folder")
    for name, ours in wanted["versions"].items():
        if (theirs := found["versions"].get(name)) != ours:
            raise ValueError(
                f"store = {str(folder)!r} was begun with {name} {theirs}, this is {ours}, and the last bit "
                "may differ; finish it with the former, or type another folder"
            )


def shard_count(shards: Shards) -> int:
    """Number of shards of the whole sweep."""
    return -(-shards.lanes // shards.chunk)


def bounds(shards: Shards, index: int) -> tuple[int, int]:
    """First lane of a shard and the one after its last."""
    return index * shards.chunk, min((index + 1) * shards.chunk, shards.lanes)


def sweep_up(folder: Path) -> None:
    """Remove what writers that were killed left beside their files."""
    for path in folder.glob(".shard-*.npy"):
        path.unlink(missing_ok=True)
    for path in folder.glob(f".{Path(MANIFEST).stem}-*.json"):
        path.unlink(missing_ok=True)


def _write_manifest(folder: Path, manifest: dict[str, Any]) -> None:
    try:
        write_json(folder / MANIFEST, manifest)
    except OSError as error:
        raise SweepError(
            f"store = {str(folder)!r} cannot be written ({error.strerror or error}); type another folder"
        ) from None


def _fill(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)


def _is_whole(path: Path) -> bool:
    return path.stem.rpartition("-")[2] == _checksum(path.read_bytes())


def _checksum(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
