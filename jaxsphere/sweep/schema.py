"""Names, types, units and coordinates of a stored sweep as the metadata files of a Zarr v3 group."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxsphere.status import Status
from jaxsphere.sweep import axes as ax
from jaxsphere.sweep.chunks import Chunks

LONG = 2**22  # positions beyond which the coordinates of an axis are not stored; `open_sweep` computes them


def axes_of(described: Sequence[Mapping[str, Any]]) -> tuple[ax.Axis, ...]:
    """Return the axes from their plain description."""
    return tuple(ax.Axis(one["name"], one["length"], tuple(_column(**part) for part in one["columns"])) for one in described)


def stored_by_lane(described: Sequence[Mapping[str, Any]], outputs: np.dtype) -> np.dtype:
    """Return names, types and shapes of what is stored for every lane: outputs, and leaves that differ by lane."""
    columns = [column for axis in axes_of(described) for column in axis.columns if ax.differs_by_lane(column)]
    kinds = [(name, outputs[name].base, outputs[name].shape) for name in outputs.names or ()]
    return np.dtype([*kinds, *((column.leaf, np.dtype("<f8"), ()) for column in columns)])


def require_storable(outputs: Sequence[str], axes: Sequence[ax.Axis]) -> None:
    """Require that outputs have names of their own. Raises ValueError for one that an axis or a folder has."""
    taken = {axis.name for axis in axes} | {column.leaf for axis in axes for column in axis.columns} | {"seals"}
    for name in outputs:
        if name in taken or "/" in name or name.startswith((".", "__")):
            raise ValueError(f"output {name!r} has the name of an axis or none that a folder can have; rename it")


def files(manifest: dict[str, Any], chunks: Chunks, arrays: np.dtype) -> dict[str, bytes]:
    """Return name -> content of every file of an empty store; the one that makes it a store comes last.

    Args:
        manifest: what the group says of the sweep; the checksums of the other files are added to it.
        chunks: how the lanes are cut.
        arrays: names, types and shapes of what is stored for every lane.
    """
    import zarr
    from zarr.codecs import Crc32cCodec
    from zarr.storage import MemoryStore

    content: dict[str, Any] = {}
    memory = MemoryStore(content)
    axes = axes_of(manifest["spec"]["axes"])
    dimensions = tuple(axis.name for axis in axes)
    columns = [(axis, column) for axis in axes for column in axis.columns]
    units = {name: one["unit"] for name, one in manifest["spec"]["outputs"].items()}
    units |= {column.leaf: column.unit for _, column in columns}
    options = {"compressors": [Crc32cCodec()], "chunk_key_encoding": {"name": "default", "separator": "."}}
    group = zarr.create_group(memory, zarr_format=3)
    for name in arrays.names or ():
        kind = arrays[name]
        group.create_array(
            name,
            shape=(*chunks.shape, *kind.shape),
            chunks=(*chunks.chunk_shape, *kind.shape),
            dtype=kind.base,
            fill_value=missing(kind.base),
            dimension_names=(*dimensions, *(f"{name}_{number}" for number in range(len(kind.shape)))),
            attributes=attributes(name, units.get(name, "")),
            **options,
        )
    for axis, column in columns:
        if axis.length <= LONG and not ax.differs_by_lane(column):
            values = ax.coordinate(axes, column)
            shown = {"chunks": values.shape, "dimension_names": [axis.name], "attributes": {"units": column.unit}}
            group.create_array(column.leaf, data=values, **shown, **options)
    leaves = [column.leaf for _, column in columns if column.leaf not in dimensions]
    seals = group.create_group("seals")
    seals.create_array(
        "sha256",
        shape=(len(chunks), len(arrays.names or ()), 32),
        chunks=(1, len(arrays.names or ()), 32),
        dtype=np.uint8,
        compressors=None,
        chunk_key_encoding={"name": "default", "separator": "."},
        dimension_names=("chunk", "array", "byte"),
        attributes={"arrays": list(arrays.names or ())},
    )
    with warnings.catch_warnings(action="ignore"):  # xarray warns where metadata are not consolidated, and Zarr where they are
        zarr.consolidate_metadata(memory)
    root = {name: buffer.to_bytes() for name, buffer in content.items()}
    head = json.loads(root.pop("zarr.json"))
    manifest["files"] = {name: _sha(data) for name, data in sorted(root.items())}
    head["attributes"] = {"jaxsphere": manifest} | ({"coordinates": " ".join(leaves)} if leaves else {})
    return dict(sorted(root.items())) | {"zarr.json": json.dumps(head, indent=2).encode()}


def missing(kind: np.dtype) -> Any:
    """Return what stands where nothing was computed: NaN, -1, or the largest unsigned number."""
    if np.issubdtype(kind, np.inexact):
        return kind.type(np.nan)
    if kind == np.bool_:
        return False
    return kind.type(np.iinfo(kind).max if np.issubdtype(kind, np.unsignedinteger) else -1)


def checksum_of(path: Path) -> str:
    """Return the SHA-256 of a file, "" when it is not there."""
    try:
        return _sha(path.read_bytes())
    except OSError:
        return ""


def attributes(name: str, unit: str) -> dict[str, Any]:
    """Return the CF attributes of an output; a status says what its numbers mean."""
    if name != "status":
        return {"units": unit} if unit else {}
    return {
        "flag_values": [int(status) for status in Status],
        "flag_meanings": " ".join(status.name.lower() for status in Status),
    }


def _column(type: str, numbers: Sequence[float], **others: Any) -> ax.Column:
    return ax.Column(numbers=tuple(numbers), **others)


def _sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
