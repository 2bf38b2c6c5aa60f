"""One sweep of real closed loops has the same bits on any number of devices and processes and in any chunks."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import sweep_cases

TESTS = Path(__file__).parent
ROOT = TESTS.parent.parent
LANES = 1320


@pytest.fixture(scope="module")
def whole():
    """The sweep in one chunk on this process' device."""
    return sweep_cases.climbs()


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """The sweep in three chunks, in a store."""
    return sweep_cases.climbs(chunk=500, store=tmp_path_factory.mktemp("stored") / "store")


@pytest.fixture(scope="module")
def reference(whole):
    """What a process prints that found the same bits."""
    return f"{sweep_cases.digest(whole)} {LANES}"


def start(*words, devices=1):
    """Run the shared sweep in a process of its own with so many host devices."""
    flags = f"--xla_force_host_platform_device_count={devices}"
    paths = os.pathsep.join([str(TESTS), str(ROOT)])
    environment = os.environ | {"XLA_FLAGS": flags, "PYTHONPATH": paths, "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, str(TESTS / "sweep_cases.py"), *map(str, words)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def said(process):
    """Last line that a process printed."""
    out, err = process.communicate(timeout=180)
    assert process.returncode == 0, err
    return out.splitlines()[-1]


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def test_the_sweep_is_no_trivial_one(whole):
    assert whole.lanes == LANES
    assert {status.name for status in whole.counts()} == {"OK", "NOT_SETTLED", "INFEASIBLE_LEAN"}
    assert len(np.unique(whole.values["final_error"])) > 1000


def test_other_chunks_give_the_same_bits(whole, stored):
    assert (whole.shards.chunks.size, stored.shards.chunks.size) == (1320, 480)
    assert sweep_cases.digest(stored) == sweep_cases.digest(whole)


def test_eight_devices_give_the_same_bits(reference):
    assert said(start(devices=8)) == f"{reference} 8"


def test_two_processes_give_the_same_bits_and_every_one_all_of_them(reference):
    port = free_port()
    both = [start(rank, port, devices=devices) for rank, devices in ((0, 2), (1, 2))]
    assert [said(process) for process in both] == [f"{reference} 4"] * 2


def test_two_processes_fill_one_store(reference, stored, tmp_path):
    port = free_port()
    both = [start(rank, port, tmp_path / "store") for rank in (0, 1)]
    assert [said(process) for process in both] == [f"{reference} 2"] * 2
    ours, theirs = (
        {str(path.relative_to(one)): path.read_bytes() for path in one.rglob("*") if path.is_file()}
        for one in (tmp_path / "store", stored.shards.folder)
    )
    assert ours == theirs
