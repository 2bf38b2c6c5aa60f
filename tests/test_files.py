"""Files that are whole or not there."""

import json
import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxsphere as js
from jaxsphere.files import write_atomically, write_json


def test_json_of_pytrees_and_numbers_that_are_not_finite(tmp_path):
    content = {"robot": js.Robot(), "status": js.Status.OK, "bad": [math.nan, np.inf, jnp.nan], "at": tmp_path, 3: (True, None)}
    path = write_json(tmp_path / "deep" / "down" / "numbers.json", content)
    read = json.loads(path.read_text())
    assert read["robot"]["shell_inertia"] == [0.018, 0.018, 0.018]
    assert read["bad"] == [None, None, None]
    assert (read["status"], read["at"], read["3"]) == (0, str(tmp_path), [True, None])


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = write_json(tmp_path / "kept.json", {"old": 1})

    def fail(temporary):
        temporary.write_text("half")
        raise RuntimeError("disk on fire")

    with pytest.raises(RuntimeError, match="disk on fire"):
        write_atomically(path, fail)
    assert [entry.name for entry in tmp_path.iterdir()] == ["kept.json"]
    assert json.loads(path.read_text()) == {"old": 1}


def test_the_temporary_file_keeps_the_suffix(tmp_path):
    seen = []
    write_atomically(tmp_path / "picture.png", lambda temporary: seen.append(temporary.suffix))
    assert seen == [".png"]


def test_a_folder_that_is_a_file_is_an_os_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="file"):
        write_json(tmp_path / "file" / "numbers.json", {})
