"""A stored sweep survives Ctrl-C, kill -9, flipped bytes and a full disk, and ends with the same bytes."""

import errno
import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
import sweep_cases
import xarray
from sweep_cases import digest, swings

import jaxsphere as js
from jaxsphere import files
from jaxsphere.sweep import store as st

TESTS = Path(__file__).parent
ROOT = TESTS.parent.parent


def content(folder):
    """Path of every file below a folder -> bytes."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(Path(folder).rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Folder of a sweep that nothing interrupted."""
    folder = tmp_path_factory.mktemp("undisturbed") / "store"
    swings(store=folder)
    return folder


@pytest.fixture
def store(undisturbed, tmp_path):
    """A copy of that folder to spoil."""
    folder = tmp_path / "store"
    shutil.copytree(undisturbed, folder)
    return folder


def shard(folder, index, name="final_state"):
    """File of one output in one chunk."""
    return folder / name / f"c.{index}.0{'.0' * (name == 'final_state')}"


def seals(folder):
    """Files of the seals."""
    return sorted((Path(folder) / "seals" / "sha256").glob("c.*"))


def stop_after(chunks):
    """Progress callback that presses Ctrl-C."""
    calls = iter(range(chunks + 1))

    def progress(done, total):
        if next(calls) == chunks:
            raise KeyboardInterrupt

    return progress


def test_stored_results_are_those_in_memory_and_open_without_the_lane_function(undisturbed):
    memory, opened = swings(), js.open_sweep(undisturbed)
    assert digest(memory) == digest(opened)
    assert opened.axes == memory.axes
    assert opened.counts() == memory.counts()
    assert sum(opened.counts().values()) == opened.lanes == 2000
    assert len(opened.counts()) > 1


def test_chunks_walk_through_all_lanes_in_order(undisturbed):
    opened = js.open_sweep(undisturbed)
    parts = list(opened.chunks())
    assert [len(part.lanes) for part in parts] == [500, 500, 500, 500]
    np.testing.assert_array_equal(np.concatenate([part.lanes for part in parts]), np.arange(2000))
    found = np.concatenate([part.outputs["final_state"] for part in parts])
    np.testing.assert_array_equal(found.reshape(40, 50, 2), opened.values["final_state"])
    angle = np.concatenate([part.leaves["angle"] for part in parts]).reshape(40, 50)
    np.testing.assert_array_equal(angle, opened.coordinates["angle"].values)


def test_xarray_opens_the_folder_lazily_with_dimensions_units_and_meanings(undisturbed):
    with warnings.catch_warnings(action="error"):
        data = xarray.open_zarr(undisturbed)
    opened = js.open_sweep(undisturbed)
    assert dict(data.sizes) == {"stiffness": 40, "draw": 50, "final_state_0": 2}
    assert set(data.coords) == {"stiffness", "angle"}
    assert not data.variables["status"]._in_memory
    for name, values in opened.values.items():
        np.testing.assert_array_equal(data[name].values, values)
        assert data[name].dtype == values.dtype
    for name, coordinate in opened.coordinates.items():
        np.testing.assert_array_equal(data[name].values, coordinate.values)
    meanings = dict(zip(data.status.attrs["flag_values"], data.status.attrs["flag_meanings"].split(), strict=True))
    assert meanings == {int(status): status.name.lower() for status in js.Status}
    assert data["end_time"].attrs["units"] == "s"
    np.testing.assert_array_equal(data.final_state.sel(stiffness=-30.0).values, opened.values["final_state"][0])


def test_zarr_itself_notices_a_flipped_byte(store):
    flip(shard(store, 2), 200)
    with pytest.raises(ValueError, match="checksum"):
        xarray.open_zarr(store).final_state.values  # noqa: B018


def test_the_group_says_what_the_sweep_is(undisturbed):
    manifest = json.loads((undisturbed / "zarr.json").read_text())["attributes"]["jaxsphere"]
    assert (manifest["format"], manifest["chunks"]) == (2, {"shape": [40, 50], "along": 0, "rows": 10})
    assert manifest["spec"]["base"] == {"damping": 0.4}
    assert manifest["spec"]["outputs"]["status"] == {"dtype": "<i4", "shape": [], "unit": ""}
    assert {"jaxsphere", "jax", "jaxlib", "numpy", "platform"} == set(manifest["versions"])


def test_after_ctrl_c_resuming_ends_with_the_same_bytes(undisturbed, tmp_path):
    with pytest.raises(KeyboardInterrupt, match=r"interrupted after 1000 of 2000 lanes; resume the same sweep"):
        swings(store=tmp_path / "store", progress=stop_after(2))
    assert len(seals(tmp_path / "store")) == 2
    with pytest.raises(ValueError, match=r"has 2 of 4 chunks; resume the same sweep"):
        js.open_sweep(tmp_path / "store")
    seen = []
    swings(store=tmp_path / "store", resume=True, chunk=1024, progress=lambda *now: seen.append(now))
    assert seen == [(1000, 2000), (1500, 2000), (2000, 2000)]
    assert content(tmp_path / "store") == content(undisturbed)


def test_resuming_a_finished_sweep_computes_nothing(store):
    before = {path: path.stat().st_mtime_ns for path in store.rglob("*")}
    seen = []
    found = swings(store=store, resume=True, progress=lambda *now: seen.append(now))
    assert seen == [(2000, 2000)]
    assert before == {path: path.stat().st_mtime_ns for path in store.rglob("*")}
    assert found.repaired == ()


def flip(path, place):
    """Flip one bit of a file."""
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)


def swap(one, other):
    """Let two files change places."""
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


def foreign(store, name):
    """Put the file of another sweep of the same shape in place of one."""
    other = swings(store=store.parent / "other", damping=0.41).shards.folder
    shutil.copy(shard(other, 2, name), shard(store, 2, name))


def everything(folder):
    """Read every chunk of every output and coordinate."""
    found = js.open_sweep(folder).shards
    return [found.read(index, name) for index in range(len(found.chunks)) for name in found.arrays.names]


DAMAGE = {
    "first byte": (lambda store: flip(shard(store, 2), 0), [2]),
    "a byte of the status": (lambda store: flip(shard(store, 2, "status"), 200), [2]),
    "last byte": (lambda store: flip(shard(store, 2), -1), [2]),
    "byte of a coordinate": (lambda store: flip(shard(store, 2, "angle"), 8), [2]),
    "byte of a seal": (lambda store: flip(seals(store)[2], 40), [2]),
    "a seal cut short": (lambda store: os.truncate(seals(store)[2], 33), [2]),
    "a file cut short": (lambda store: os.truncate(shard(store, 0), 1000), [0]),
    "a file gone": (lambda store: shard(store, 1, "end_time").unlink(), [1]),
    "two renamed": (lambda store: swap(shard(store, 1), shard(store, 2)), [1, 2]),
    "one over another": (lambda store: shutil.copy(shard(store, 1), shard(store, 2)), [2]),
    "two outputs renamed": (lambda store: swap(shard(store, 2, "status"), shard(store, 2, "end_time")), [2]),
    "two seals renamed": (lambda store: swap(*seals(store)[:2]), [0, 1]),
    "of another sweep": (lambda store: foreign(store, "final_state"), [2]),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_is_reported_and_repaired(undisturbed, store, damage):
    spoil, chunks = DAMAGE[damage]
    spoil(store)
    with pytest.raises(js.SweepError, match=rf"chunk {chunks[0]} of store = .* is damaged \(.*\); resume the same sweep"):
        everything(store)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = swings(store=store, resume=True)
    assert [str(one.message).rpartition(": ")[2] for one in caught] == [", ".join(map(str, chunks))]
    assert found.repaired == tuple(chunks)
    assert content(store) == content(undisturbed)


def test_a_chunk_that_is_gone_comes_back(undisturbed, store):
    seals(store)[3].unlink()
    with pytest.raises(js.SweepError, match=r"chunk 3 of store = .* is missing"):
        st.load(store).read(3, "status")
    assert swings(store=store, resume=True).repaired == ()
    assert content(store) == content(undisturbed)


def test_edited_axes_types_and_coordinates_are_noticed(undisturbed, store):
    text = (store / "zarr.json").read_text()
    edited = json.loads(text)
    edited["attributes"]["jaxsphere"]["spec"]["axes"][0]["columns"][0]["numbers"][1] = 11.0
    (store / "zarr.json").write_text(json.dumps(edited))
    for run in (lambda: js.open_sweep(store), lambda: swings(store=store, resume=True)):
        with pytest.raises(ValueError, match=r"is of another sweep \(zarr\.json was edited\)"):
            run()
    (store / "zarr.json").write_text(text)
    flip(store / "stiffness" / "c.0", 3)
    with pytest.raises(js.SweepError, match=r"stiffness/c\.0 of store = .* is damaged; resume the same sweep"):
        js.open_sweep(store)
    swings(store=store, resume=True)
    assert content(store) == content(undisturbed)


def test_what_a_killed_writer_left_is_removed_and_what_a_living_one_writes_is_kept(undisturbed, store):
    gone = subprocess.Popen(["true"])
    gone.wait()
    for folder in ("", "status", "seals/sha256"):
        (store / folder / f".c.0~{files._host()}~{gone.pid}~abc.0").write_bytes(b"half")
    living = store / "status" / f".c.1~{files._host()}~{os.getppid()}~abc.0"
    living.write_bytes(b"half")
    swings(store=store, resume=True)
    assert living.exists()
    living.unlink()
    assert content(store) == content(undisturbed)


def test_a_full_disk_is_one_sentence_and_loses_nothing(undisturbed, tmp_path, monkeypatch):
    fill, calls = st._fill, []

    def full(data, path):
        calls.append(path)
        if len(seals(tmp_path / "store")) == 2:
            path.write_bytes(data[:100])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fill(data, path)

    monkeypatch.setattr(st, "_fill", full)
    with pytest.raises(
        js.SweepError, match=r"cannot take chunk 2 \(No space left on device\); 2 of 4 chunks are safe: make room"
    ):
        swings(store=tmp_path / "store")
    assert len(seals(tmp_path / "store")) == 2
    assert not list((tmp_path / "store").rglob(".*"))
    monkeypatch.undo()
    swings(store=tmp_path / "store", resume=True)
    assert content(tmp_path / "store") == content(undisturbed)


def test_a_limit_of_the_operating_system_is_one_sentence_and_loses_nothing(undisturbed, tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def progress(done, total):
        if done == 1000:
            resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))

    try:
        with pytest.raises(js.SweepError, match=r"cannot take chunk 2 \(File too large\); 2 of 4 chunks are safe"):
            swings(store=tmp_path / "store", progress=progress)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    swings(store=tmp_path / "store", resume=True)
    assert content(tmp_path / "store") == content(undisturbed)


# Imports once, then forks a sweeper for every line that it reads: a process of its own, without the wait for imports.
NURSERY = """
import os, sys, time
import sweep_cases
folder = sys.argv[1]
for line in sys.stdin:
    child = os.fork()
    if child == 0:
        def progress(done, total):
            print(os.getpid(), done, flush=True)
            time.sleep(0.01)
        try:
            resume = os.path.exists(folder + "/zarr.json")
            sweep_cases.swings(count=400, store=folder, resume=resume, progress=progress)
            print(os.getpid(), "finished", flush=True)
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    print("gone", flush=True)
"""


def test_kill_minus_nine_at_ten_random_moments_ends_with_the_same_bytes(tmp_path):
    paths = os.pathsep.join([str(TESTS), str(ROOT)])
    nursery = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", NURSERY, str(tmp_path / "killed")],
        env=os.environ | {"PYTHONPATH": paths, "JAX_PLATFORMS": "cpu"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    moments, kills, lines = random.Random(sweep_cases.__name__), 0, []
    for _ in range(10):
        nursery.stdin.write("go\n")
        nursery.stdin.flush()
        for _ in range(moments.randint(1, 4)):  # the first report comes when the store is open, the others after shards
            pid, _ = nursery.stdout.readline().split()
        time.sleep(moments.uniform(0.0, 0.025))
        os.kill(int(pid), signal.SIGKILL)
        while (line := nursery.stdout.readline().strip()) != "gone":
            lines.append(line)
        kills += "finished" not in (lines[-1] if lines else "")
    done = len(seals(tmp_path / "killed"))
    nursery.stdin.close()
    nursery.wait(timeout=60)
    assert kills == 10
    assert 10 < done < 40
    swings(count=400, store=tmp_path / "killed", resume=True)
    swings(count=400, store=tmp_path / "whole")
    assert content(tmp_path / "killed") == content(tmp_path / "whole")


def refused(named, **options):
    """Require one sentence."""
    with pytest.raises(ValueError, match=named) as caught:
        swings(**options)
    assert "\n" not in str(caught.value)


def test_a_store_that_does_not_fit_is_refused(store, tmp_path):
    before = content(store)
    refused(r"holds a sweep already; resume the same sweep", store=store)
    refused(r"holds no sweep to resume; start it without resume", store=tmp_path / "nothing", resume=True)
    refused(r"resume = True needs the folder", resume=True)
    refused(r"is of another sweep \(it differs in axes\); type another folder", store=store, resume=True, count=41)
    refused(r"is of another sweep \(it differs in dtype, outputs\)", store=store, resume=True, dtype=np.float32)
    assert content(store) == before
    assert not (tmp_path / "nothing").exists()
    (store / "zarr.json").unlink()
    refused(r"holds chunks without zarr\.json; type another folder", store=store)


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("format", 99, r"has format 99, not 2"),
        ("versions", {"jaxsphere": "0.0.1"}, r"was begun with jaxsphere 0\.0\.1, this is"),
        ("fingerprint", "", r"is of another sweep"),
    ],
)
def test_a_store_of_another_version_is_refused(store, key, value, named):
    group = json.loads((store / "zarr.json").read_text())
    group["attributes"]["jaxsphere"][key] = value
    (store / "zarr.json").write_text(json.dumps(group))
    refused(named, store=store, resume=True)


def test_a_store_that_is_none_and_a_folder_that_cannot_be_written_are_named(tmp_path):
    (tmp_path / "zarr.json").write_text("{")
    refused(r"has no readable zarr\.json", store=tmp_path, resume=True)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(js.SweepError, match=r"cannot be written .*; type another folder"):
        swings(store=tmp_path / "file" / "store")


def test_outputs_need_names_of_their_own_in_a_store(tmp_path):
    axis = js.axes.listed("x", [1.0, 2.0])
    for name in ("x", "a/b", "seals", ".hidden"):
        with pytest.raises(ValueError, match=r"output '.*' has the name of an axis or none that a folder can have; rename it"):
            js.sweep(lambda x, name=name: {name: x}, {}, axis, store=tmp_path / "store")


def test_reading_is_linear_and_a_trillion_lanes_cost_nothing_before_the_first(tmp_path):
    """Lanes go in order through chunks of any shape, and what comes before the first chunk does not grow with them."""
    tracemalloc.start()
    axes = [js.axes.linear("x", 0.0, 1.0, 10**6), js.axes.linear("y", 0.0, 1.0, 10**6)]

    def progress(done, total):
        assert total == 10**12
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="interrupted after 0 of 1000000000000 lanes"):
        js.sweep(lambda x, y: x + y, {}, axes, store=tmp_path / "store", progress=progress)
    assert tracemalloc.get_traced_memory()[1] < 100e6
    tracemalloc.stop()
