"""The folder that keeps the results of a sweep, chunk by chunk.

The folder is a Zarr v3 group that `xarray.open_zarr(FOLDER)` opens: an array over the axes of the sweep for every output and
coordinate, units and meanings as attributes, CRC-32C in every chunk file. The attribute "jaxsphere" of the group says what the
sweep is.

A chunk of lanes is one Zarr chunk of every array. `seals/sha256` holds one entry for each of them, written when all its files
are in place: SHA-256 of the sweep's fingerprint, the number of the chunk, the name of the array and its bytes. A chunk without
a seal is not done; one that does not match its seal is damaged. Every file is renamed into its place when it is complete.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxsphere.files import remove_abandoned, write_atomically
from jaxsphere.identity import fingerprint
from jaxsphere.sweep import schema
from jaxsphere.sweep.chunks import Chunks
from jaxsphere.sweep.memory import Record

FORMAT = 2
ROOT = "zarr.json"
SEALS = "seals/sha256"
JOURNAL = "seals/journal"
RESUME = "resume the same sweep to go on (resume=True or --resume)"
_SEAL = 32  # bytes
_CRC = 4  # bytes


class SweepError(RuntimeError):
    """A sweep could not go on, or its store cannot be read; what is done stays in the store."""


@dataclass
class Store:
    """Results in a folder. manifest: what `describe` returned."""

    folder: Path
    manifest: dict[str, Any]

    @property
    def chunks(self) -> Chunks:
        """How the lanes are cut."""
        cut = self.manifest["chunks"]
        return Chunks(tuple(cut["shape"]), cut["along"], cut["rows"])

    @property
    def layout(self) -> np.dtype:
        """Names, types and shapes of the outputs of one lane."""
        outputs = self.manifest["spec"]["outputs"]
        return np.dtype([(name, one["dtype"], tuple(one["shape"])) for name, one in outputs.items()])

    @property
    def units(self) -> Mapping[str, str]:
        """Output -> unit, where it is known."""
        return {name: one["unit"] for name, one in self.manifest["spec"]["outputs"].items()}

    @cached_property
    def arrays(self) -> np.dtype:
        """Names, types and shapes of what is stored for every lane: the outputs and the leaves that differ by lane."""
        return schema.stored_by_lane(self.manifest["spec"]["axes"], self.layout)

    def read(self, index: int, name: str) -> np.ndarray:
        """One array in the lanes of one chunk, (n, ...). Raises SweepError when it is missing or damaged."""
        seal = self._seal(index)
        if seal is None:
            raise SweepError(f"chunk {index} of store = {str(self.folder)!r} is missing; {RESUME}")
        data = self._whole(index, name, seal)
        if data is None:
            raise SweepError(f"chunk {index} of store = {str(self.folder)!r} is damaged ({name}); {RESUME}")
        kind = self.arrays[name]
        return np.frombuffer(data[:-_CRC], kind.base).reshape(-1, *kind.shape)[: self.chunks.count(index)]

    def write(self, index: int, record: Record) -> None:
        """Write one chunk and then its seal. Raises SweepError with one sentence when the folder cannot take it."""
        seal = b""
        try:
            for name in self._names:
                data = _encoded(record[name], self.arrays[name], self.chunks)
                write_atomically(self._path(index, name), partial(_fill, data))
                seal += self._checksum(index, name, data)
            write_atomically(self._seal_path(index), partial(_fill, seal))
        except OSError as error:
            raise SweepError(
                f"store = {str(self.folder)!r} cannot take chunk {index} ({error.strerror or error}); {self.done()} of "
                f"{len(self.chunks)} chunks are safe: make room and {RESUME}"
            ) from None

    def remember(self, batch: int, record: Record) -> None:
        """Keep lanes of a refinement until it is finished. Raises SweepError when the folder cannot take them."""
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **record)  # type: ignore[arg-type]
        data = self._checksum(batch, JOURNAL, buffer.getvalue()) + buffer.getvalue()
        try:
            write_atomically(self.folder / JOURNAL / str(batch), partial(_fill, data))
        except OSError as error:
            raise SweepError(
                f"store = {str(self.folder)!r} cannot take batch {batch} ({error.strerror or error}); those before it are "
                f"safe: make room and {RESUME}"
            ) from None

    def recall(self, batch: int) -> Record | None:
        """What was remembered, None when there is nothing or it is damaged."""
        try:
            data = (self.folder / JOURNAL / str(batch)).read_bytes()
        except FileNotFoundError:
            return None
        if data[:_SEAL] != self._checksum(batch, JOURNAL, data[_SEAL:]):
            return None
        return dict(np.load(io.BytesIO(data[_SEAL:])))

    def forget(self) -> None:
        """Remove all that was remembered."""
        shutil.rmtree(self.folder / JOURNAL, ignore_errors=True)

    def done(self) -> int:
        """Number of chunks that have a seal."""
        with os.scandir(self.folder / SEALS) as entries:
            return sum(entry.name.startswith("c.") for entry in entries)

    def check(self, chunks: Iterable[int]) -> tuple[set[int], list[int]]:
        """Return the numbers of those chunks that are done and whole, and of those that are damaged."""
        whole, damaged = set(), []
        if self.done():
            for index in chunks:
                if (seal := self._seal(index)) is None:
                    continue
                if all(self._whole(index, name, seal) is not None for name in self._names):
                    whole.add(index)
                else:
                    damaged.append(index)
        return whole, damaged

    def discard(self, chunks: Iterable[int]) -> None:
        """Count these chunks as missing."""
        for index in chunks:
            self._seal_path(index).unlink(missing_ok=True)

    def sweep_up(self) -> None:
        """Remove what writers that were killed left beside their files."""
        for name in ("", SEALS, JOURNAL, *self._names):
            remove_abandoned(self.folder / name)

    @property
    def _names(self) -> tuple[str, ...]:
        return self.arrays.names or ()

    def _path(self, index: int, name: str) -> Path:
        inner = [0] * len(self.arrays[name].shape)
        return self.folder / name / ".".join(["c", *map(str, (*self.chunks.place(index), *inner))])

    def _seal_path(self, index: int) -> Path:
        return self.folder / SEALS / f"c.{index}.0.0"

    def _seal(self, index: int) -> bytes | None:
        try:
            return self._seal_path(index).read_bytes()
        except FileNotFoundError:
            return None

    def _whole(self, index: int, name: str, seal: bytes) -> bytes | None:
        """Bytes of a chunk file, None when they are not those that were sealed."""
        place = _SEAL * self._names.index(name)
        try:
            data = self._path(index, name).read_bytes()
        except FileNotFoundError:
            return None
        return data if seal[place : place + _SEAL] == self._checksum(index, name, data) else None

    def _checksum(self, index: int, name: str, data: bytes) -> bytes:
        return hashlib.sha256(f"{self._identity} {index} {name} ".encode() + data).digest()

    @cached_property
    def _identity(self) -> str:
        return f"{self.manifest['fingerprint']} {self.manifest['chunks']['along']} {self.manifest['chunks']['rows']}"


def describe(spec: dict[str, Any], versions: dict[str, str], chunks: Chunks) -> dict[str, Any]:
    """Return what the store says of itself: what is swept, by which versions, in which chunks."""
    cut = {"shape": list(chunks.shape), "along": chunks.along, "rows": chunks.rows}
    return {"format": FORMAT, "fingerprint": fingerprint(spec), "versions": versions, "chunks": cut, "spec": spec}


def create(store: Store) -> None:
    """Write names, types and coordinates of a new store. Raises SweepError when the folder cannot be written."""
    try:
        for name, data in schema.files(store.manifest, store.chunks, store.arrays).items():
            write_atomically(store.folder / name, partial(_fill, data))
    except OSError as error:
        raise SweepError(
            f"store = {str(store.folder)!r} cannot be written ({error.strerror or error}); type another folder"
        ) from None


def load(folder: Path) -> Store:
    """Open a store that is there. Raises ValueError when it is not, of another format, or was edited."""
    try:
        manifest = json.loads((folder / ROOT).read_text(encoding="utf-8"))["attributes"]["jaxsphere"]
        number, said, meant = manifest["format"], manifest["fingerprint"], fingerprint(manifest["spec"])
    except FileNotFoundError:
        raise ValueError(f"store = {str(folder)!r} holds no sweep to resume; start it without resume") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"store = {str(folder)!r} has no readable {ROOT} ({error}); type another folder") from None
    if number != FORMAT:
        raise ValueError(f"store = {str(folder)!r} has format {number!r}, not {FORMAT}; type another folder")
    if said != meant:
        raise ValueError(f"store = {str(folder)!r} is of another sweep ({ROOT} was edited); type another folder")
    return Store(folder, manifest)


def changed_files(store: Store) -> list[str]:
    """Return the names of the files of names, types and coordinates that are not as `create` wrote them."""
    wanted = store.manifest["files"]
    return [name for name, checksum in wanted.items() if schema.checksum_of(store.folder / name) != checksum]


def require_empty(folder: Path) -> None:
    """Require that no sweep is in the folder. Raises ValueError otherwise."""
    if (folder / ROOT).exists():
        raise ValueError(f"store = {str(folder)!r} holds a sweep already; {RESUME}, or type another folder")
    if any(folder.glob(f"{SEALS}/c.*")):
        raise ValueError(f"store = {str(folder)!r} holds chunks without {ROOT}; type another folder")


def require_same(found: dict[str, Any], wanted: dict[str, Any], folder: Path) -> None:
    """Require that the store holds this very sweep, by these versions. Raises ValueError naming what differs."""
    for name, ours in wanted["versions"].items():
        if (theirs := found["versions"].get(name)) != ours:
            raise ValueError(
                f"store = {str(folder)!r} was begun with {name} {theirs}, this is {ours}, and the last bit "
                "may differ; finish it with the former, or type another folder"
            )
    if found["fingerprint"] != wanted["fingerprint"]:
        one, other = found["spec"], wanted["spec"]
        parts = [key for key in sorted(one | other) if one.get(key) != other.get(key)]
        # Whatever else differs is part of the traced program too.
        named = ", ".join(part for part in parts if part != "lane" or len(parts) == 1)
        raise ValueError(f"store = {str(folder)!r} is of another sweep (it differs in {named}); type another folder")


def _encoded(values: np.ndarray, kind: np.dtype, chunks: Chunks) -> bytes:
    """Bytes of a Zarr chunk: little-endian values, filled up to the size of a full chunk, and their CRC-32C."""
    import google_crc32c

    full = np.full((chunks.size, *kind.shape), schema.missing(kind.base), kind.base.newbyteorder("<"))
    full[: len(values)] = values
    data = full.tobytes()
    return data + google_crc32c.value(data).to_bytes(_CRC, "little")


def _fill(data: bytes, path: Path) -> None:
    path.write_bytes(data)
