"""Where results go: one folder with pictures, metrics.json and manifest.json, every file written atomically."""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxsphere.files import write_atomically, write_json


class Record:
    """An output folder being filled. Raises ValueError with one sentence when the folder cannot be written."""

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)
        self._started = time.time()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_atomically(self.folder / ".probe", lambda path: None).unlink()
        except OSError as error:
            raise ValueError(
                f"out = {str(folder)!r} cannot be written ({error.strerror}); type a folder of your own, e.g. --out out"
            ) from None

    def picture(self, name: str, figure: Figure) -> Path:
        """Save `figure` as NAME.png."""
        return write_atomically(self.folder / f"{name}.png", lambda path: figure.savefig(path, dpi=150))

    def finish(self, metrics: dict[str, Any], **subject: Any) -> None:
        """Write metrics.json and, with `subject` (robot, gains, settings), manifest.json."""
        write_json(self.folder / "metrics.json", metrics)
        write_json(
            self.folder / "manifest.json", {**environment(), "seconds": round(time.time() - self._started, 2), **subject}
        )


@contextmanager
def progress_bar(unit: str, shown: bool) -> Iterator[Callable[[int, int], None]]:
    """Yield a function of (done, total) that moves a progress bar."""
    with tqdm(unit=unit, unit_scale=True, disable=not shown) as bar:

        def report(done: int, total: int) -> None:
            if bar.total != total:
                bar.reset(total)
                bar.initial = done  # what was stored before says nothing about the rate
            bar.n = done
            bar.refresh()

        yield report


def environment() -> dict[str, Any]:
    """Versions, devices, dtype and command of this run."""
    return {
        "versions": {
            "python": platform.python_version(),
            **{name: _version(name) for name in ("jaxsphere", "jax", "jaxlib", "numpy")},
        },
        "devices": [f"{device.platform}:{device.device_kind}" for device in jax.local_devices()],
        "dtype": str(np.dtype(jax.dtypes.canonicalize_dtype(np.float64))),
        "command": " ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "date": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
