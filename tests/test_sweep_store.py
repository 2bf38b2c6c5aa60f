"""A stored sweep survives Ctrl-C, kill -9, flipped bytes and a full disk, and ends with the same bytes."""

import errno
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import sweep_cases
from sweep_cases import digest, swings

import jaxsphere as js
from jaxsphere.simulation.sweeps import store as st

TESTS = Path(__file__).parent


def content(folder):
    """File name -> bytes."""
    return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


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
    folder.mkdir()
    for name, data in content(undisturbed).items():
        (folder / name).write_bytes(data)
    return folder


def shard(folder, index):
    """File of one shard."""
    (path,) = folder.glob(f"shard-{index:06d}-*.npy")
    return path


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
    assert isinstance(opened.shards.read(0), np.memmap)


def test_chunks_walk_through_all_lanes_in_order(undisturbed):
    opened = js.open_sweep(undisturbed)
    parts = list(opened.chunks())
    assert [len(part.lanes) for part in parts] == [512, 512, 512, 464]
    np.testing.assert_array_equal(np.concatenate([part.lanes for part in parts]), np.arange(2000))
    found = np.concatenate([part.outputs["final_state"] for part in parts])
    np.testing.assert_array_equal(found.reshape(40, 50, 2), opened.values["final_state"])
    angle = np.concatenate([part.leaves["angle"] for part in parts]).reshape(40, 50)
    np.testing.assert_array_equal(angle, opened.coordinates["angle"].values)


def test_the_manifest_says_what_the_sweep_is(undisturbed):
    manifest = json.loads((undisturbed / "manifest.json").read_text())
    assert (manifest["format"], manifest["lanes"], manifest["chunk"]) == (1, 2000, 512)
    assert manifest["spec"]["base"] == {"damping": 0.4}
    assert manifest["spec"]["outputs"]["status"] == {"dtype": "<i4", "shape": []}
    assert {"jaxsphere", "jax", "jaxlib", "numpy", "platform"} == set(manifest["versions"])
    assert manifest["checksums"] == [shard(undisturbed, index).stem.rpartition("-")[2] for index in range(4)]


def test_after_ctrl_c_resuming_ends_with_the_same_bytes(undisturbed, tmp_path):
    with pytest.raises(KeyboardInterrupt, match=r"interrupted after 1024 of 2000 lanes; resume the same sweep"):
        swings(store=tmp_path / "store", progress=stop_after(2))
    assert len(list((tmp_path / "store").glob("shard-*"))) == 2
    with pytest.raises(ValueError, match=r"has 2 of 4 shards; resume the same sweep"):
        js.open_sweep(tmp_path / "store")
    seen = []
    swings(store=tmp_path / "store", resume=True, chunk=1024, progress=lambda *now: seen.append(now))
    assert seen == [(1024, 2000), (1536, 2000), (2000, 2000)]
    assert content(tmp_path / "store") == content(undisturbed)


def test_resuming_a_finished_sweep_computes_nothing(store):
    before = {path: path.stat().st_mtime_ns for path in store.glob("shard-*")}
    seen = []
    found = swings(store=store, resume=True, progress=lambda *now: seen.append(now))
    assert seen == [(2000, 2000)]
    assert before == {path: path.stat().st_mtime_ns for path in store.glob("shard-*")}
    assert found.repaired == ()


@pytest.mark.parametrize("place", [0, 200, -1])
def test_a_flipped_byte_is_reported_and_repaired(undisturbed, store, place):
    path = shard(store, 2)
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    with pytest.raises(js.SweepError, match=r"shard 2 of store = .* is damaged; resume the same sweep"):
        js.open_sweep(store).counts()
    with pytest.warns(UserWarning, match=r"damaged shards of .*, computed again: 2$"):
        found = swings(store=store, resume=True)
    assert found.repaired == (2,)
    assert content(store) == content(undisturbed)


def test_a_shard_under_a_wrong_checksum_is_replaced(undisturbed, store):
    shard(store, 1).rename(store / "shard-000001-0123456789abcdef.npy")
    with pytest.warns(UserWarning, match=r"computed again: 1$"):
        swings(store=store, resume=True)
    assert content(store) == content(undisturbed)


def test_a_shard_cut_short_and_one_that_is_gone_come_back(undisturbed, store):
    os.truncate(shard(store, 0), 1000)
    shard(store, 3).unlink()
    with pytest.raises(js.SweepError, match=r"shard 3 of store = .* is missing"):
        js.open_sweep(store).shards.read(3)
    with pytest.warns(UserWarning, match=r"computed again: 0$"):
        swings(store=store, resume=True)
    assert content(store) == content(undisturbed)


def test_what_a_killed_writer_left_is_removed(undisturbed, store):
    (store / ".shard-000001-abc-xyz.npy").write_bytes(b"half")
    swings(store=store, resume=True)
    assert content(store) == content(undisturbed)


def test_a_full_disk_is_one_sentence_and_loses_nothing(undisturbed, tmp_path, monkeypatch):
    fill, calls = st._fill, []

    def full(path, data):
        calls.append(path)
        if len(calls) == 3:
            path.write_bytes(data[:100])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fill(path, data)

    monkeypatch.setattr(st, "_fill", full)
    with pytest.raises(
        js.SweepError, match=r"cannot take shard 2 \(No space left on device\); 2 of 4 shards are safe: make room"
    ):
        swings(store=tmp_path / "store")
    assert len(content(tmp_path / "store")) == 3  # with the manifest
    monkeypatch.undo()
    swings(store=tmp_path / "store", resume=True)
    assert content(tmp_path / "store") == content(undisturbed)


def test_a_limit_of_the_operating_system_is_one_sentence_and_loses_nothing(undisturbed, tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def progress(done, total):
        if done == 1024:
            resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))

    try:
        with pytest.raises(js.SweepError, match=r"cannot take shard 2 \(File too large\); 2 of 4 shards are safe"):
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
            resume = os.path.exists(folder + "/manifest.json")
            sweep_cases.swings(count=400, store=folder, resume=resume, progress=progress)
            print(os.getpid(), "finished", flush=True)
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    print("gone", flush=True)
"""


def test_kill_minus_nine_at_ten_random_moments_ends_with_the_same_bytes(tmp_path):
    paths = os.pathsep.join([str(TESTS), str(TESTS.parent)])
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
    done = len(list((tmp_path / "killed").glob("shard-*")))
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
    (store / "manifest.json").unlink()
    refused(r"holds shards without manifest\.json; type another folder", store=store)


def test_another_lane_function_is_told_by_its_code_and_by_what_it_captured(tmp_path):
    axis = js.axes.listed("x", [1.0, 2.0])

    def scaled(factor):
        return lambda x: factor * x

    js.sweep(scaled(2.0), {}, axis, store=tmp_path / "store")
    js.sweep(scaled(2.0), {}, axis, store=tmp_path / "store", resume=True)
    for other in (scaled(3.0), lambda x: x + 2.0):
        with pytest.raises(ValueError, match=r"another sweep \(it differs in lane\)"):
            js.sweep(other, {}, axis, store=tmp_path / "store", resume=True)


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("format", 99, r"has format 99, not 1"),
        ("versions", {"jaxsphere": "0.0.1"}, r"was begun with jaxsphere 0\.0\.1, this is"),
        ("fingerprint", "", r"is of another sweep"),
    ],
)
def test_a_store_of_another_version_is_refused(store, key, value, named):
    manifest = json.loads((store / "manifest.json").read_text())
    (store / "manifest.json").write_text(json.dumps(manifest | {key: value}))
    refused(named, store=store, resume=True)


def test_a_manifest_that_is_none_and_a_folder_that_cannot_be_written_are_named(tmp_path):
    (tmp_path / "manifest.json").write_text("{")
    refused(r"has no readable manifest\.json", store=tmp_path, resume=True)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(js.SweepError, match=r"cannot be written .*; type another folder"):
        swings(store=tmp_path / "file" / "store")
