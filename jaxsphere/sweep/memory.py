"""Where the results of a sweep lie, chunk by chunk: what a sweep asks of such a place, and the one in memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from jaxsphere.sweep.chunks import Chunks

Record = Mapping[str, np.ndarray]  # output -> its values in the lanes of a chunk, (n, ...)


class Shards(Protocol):
    """What a sweep writes its results to, chunk by chunk, and what they are read from."""

    @property
    def chunks(self) -> Chunks:
        """How the lanes are cut."""
        ...

    @property
    def layout(self) -> np.dtype:
        """Names, types and shapes of the outputs of one lane."""
        ...

    @property
    def units(self) -> Mapping[str, str]:
        """Output -> unit, where it is known."""
        ...

    def read(self, index: int, name: str) -> np.ndarray:
        """One output in the lanes of one chunk, (n, ...)."""
        ...

    def write(self, index: int, record: Record) -> None:
        """Keep the outputs of one chunk."""
        ...

    def remember(self, batch: int, record: Record) -> None:
        """Keep lanes of a refinement, which are in no order of chunks, until it is finished."""
        ...

    def recall(self, batch: int) -> Record | None:
        """What was remembered, None when there is nothing or it is damaged."""
        ...

    def forget(self) -> None:
        """Remove all that was remembered."""
        ...


@dataclass
class Memory:
    """Results that live as long as the process."""

    chunks: Chunks
    layout: np.dtype
    units: Mapping[str, str]
    records: dict[int, Record] = field(default_factory=dict)

    def read(self, index: int, name: str) -> np.ndarray:
        """One output in the lanes of one chunk, (n, ...)."""
        return self.records[index][name]

    def write(self, index: int, record: Record) -> None:
        """Keep the outputs of one chunk."""
        self.records[index] = {name: record[name] for name in self.layout.names or ()}

    def remember(self, batch: int, record: Record) -> None:
        """Do nothing: memory does not outlive the process."""

    def recall(self, batch: int) -> Record | None:
        """Return None."""

    def forget(self) -> None:
        """Do nothing."""
