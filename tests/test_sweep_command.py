"""`jaxsphere sweep SPEC.toml` as a user meets it."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxsphere as js
from experiments import cli
from experiments.cli.sweep_spec import read_spec

ROOT = Path(__file__).parent.parent
HEAD = """
outputs = ["final_error", "peak_torque"]
[robot]
name = "set_a"
pendulum_mass = 2.1
[gains]
c1 = 0.6
[settings]
duration = 0.4
dt = 1e-2
method = "semi_implicit_euler"
initial_state = [0, 0, 0.3, 0]
"""
MAP = """
[[axes]]
name = "slope_deg"
grid = {from = 0, to = 22, count = 12}
[[axes]]
name = "robot.shell_mass"
grid = {from = 0.5, to = 2, count = 5, scale = "log"}
"""
OTHERS = """
[[axes]]
latin_hypercube = {"slope_deg" = [0, 22], "gains.c2" = [1, 4]}
count = 9
seed = 4
[[axes]]
name = "start"
zip = [{uniform = {"initial_state.3" = [0, 1]}, count = 2}, {normal = {"initial_state.1" = [0, 1]}, count = 2}]
[[axes]]
name = "travel"
values = [3, 5]
"""
LINE = """
task = "track_line"
dtype = "float32"
outputs = ["rms_error"]
[settings]
duration = 0.1
dt = 1e-2
[[axes]]
name = "speed"
values = [0.2, 0.5, 0.8]
"""


def run(capsys, folder, text, *words):
    """Run the command on a spec in this process; return its exit code and what it printed."""
    (folder / "spec.toml").write_text(text)
    code = cli.main(["sweep", str(folder / "spec.toml"), "--out", str(folder / "out"), "--no-progress", *words])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_a_map_is_swept_counted_drawn_and_stored(capsys, tmp_path):
    code, out, err = run(capsys, tmp_path, HEAD + MAP)
    assert code == 0, err
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["manifest.json", "metrics.json", "store", "sweep.png"]
    numbers = json.loads((tmp_path / "out" / "metrics.json").read_text())["sweep"]
    assert (numbers["lanes"], numbers["shape"], numbers["axes"]) == (60, [12, 5], ["slope", "robot.shell_mass"])
    assert sum(numbers["statuses"].values()) == 60
    assert numbers["statuses"]["infeasible_lean"] > 0
    assert "60 lanes: " in out
    assert "infeasible_lean" in out
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["sweep"]["robot"]["pendulum_mass"] == 2.1
    results = js.open_sweep(tmp_path / "out" / "store")
    assert set(results.values) == {"status", "final_error", "peak_torque"}
    slope, mass = (results.coordinates[name].values for name in ("slope", "robot.shell_mass"))
    np.testing.assert_allclose(slope, np.linspace(0.0, 22.0, 12))
    single = js.rest_to_rest(
        js.Robot(pendulum_mass=2.1, shell_mass=mass[3]),
        np.deg2rad(slope[4]),
        js.SlidingModeGains(c1=0.6),
        initial_state=np.array([0.0, 0.0, 0.3, 0.0]),
        duration=0.4,
        dt=1e-2,
        method="semi_implicit_euler",
    )
    np.testing.assert_allclose(results.values["final_error"][4, 3], single.metrics.final_error, rtol=1e-9)

    code, _, err = run(capsys, tmp_path, HEAD + MAP)
    assert code == 2
    assert "holds a sweep already; resume the same sweep to go on (resume=True or --resume)" in err
    code, again, err = run(capsys, tmp_path, HEAD + MAP, "--resume")
    assert code == 0, err
    assert again == out


def test_samples_draws_zips_and_lists_are_drawn_as_strips(capsys, tmp_path):
    code, _, err = run(capsys, tmp_path, HEAD + OTHERS)
    assert code == 0, err
    results = js.open_sweep(tmp_path / "out" / "store")
    assert results.dimensions == ("sample", "start", "travel")
    assert results.shape == (9, 2, 2)
    assert [column.unit for column in results.columns][:2] == ["deg", "1/s"]
    together = js.axes.latin_hypercube({"gains.c2": (1.0, 4.0)}, 9, seed=4)
    np.testing.assert_array_equal(results.coordinates["gains.c2"].values, js.axes.coordinate([together], together.columns[0]))
    assert (tmp_path / "out" / "sweep.png").stat().st_size > 10_000


def test_lines_are_tracked_in_single_precision(capsys, tmp_path):
    code, _, err = run(capsys, tmp_path, LINE)
    assert code == 0, err
    results = js.open_sweep(tmp_path / "out" / "store")
    assert results.values["rms_error"].dtype == np.float32
    assert (tmp_path / "out" / "sweep.png").stat().st_size > 10_000


def test_bench_prints_lanes_and_memory(capsys, tmp_path):
    assert cli.main(["bench", "--case", "sweep", "--lanes", "600", "--steps", "5", "--out", str(tmp_path)]) == 0
    numbers = json.loads((tmp_path / "metrics.json").read_text())["sweep"]
    assert [numbers[f"{lanes} lanes"]["sum_of_statuses"] for lanes in (60, 600)] == [60, 600]
    assert numbers["600 lanes"]["peak_memory_MB"] >= numbers["60 lanes"]["peak_memory_MB"] > 50.0
    assert "peak memory" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bench_sweep.png", "manifest.json", "metrics.json"]


def test_the_spec_that_ships_is_admissible():
    spec = read_spec(ROOT / "experiments" / "specs" / "sweep.toml")
    assert [axis.length for axis in spec.axes] == [32, 41]
    assert spec.base["duration"] == 20.0


FAULTS = [
    ("axes = [", "is no TOML: "),
    ("colour = 1" + MAP, "'colour' in the spec is unknown; type one of task, outputs"),
    ("[settings]\nslop = 1" + MAP, "'slop' in [settings] is unknown; type one of slope_deg"),
    ("task = 'dance'" + MAP, "task = 'dance' is not known; type one of rest_to_rest, track_line"),
    ("[robot]\nname = 'nobody'" + MAP, "robot = 'nobody' is not known; type one of set_a"),
    ("[robot]\nshell_mass = -1" + MAP, "robot.shell_mass = -1 is not admissible"),
    ("[gains]\nc1 = 0" + MAP, "gains.c1 = 0 is not admissible"),
    ("[settings]\nslope_deg = 100" + MAP, "slope_deg = 100 deg is not admissible"),
    ("[settings]\ndt = 'fast'" + MAP, "[settings]: dt = 'fast' is not a number; type a number"),
    ("dtype = 'float16'" + MAP, "dtype = 'float16' is not known"),
    ("chunk = 0" + MAP, "chunk = 0 is not admissible"),
    ("outputs = ['speed']" + MAP, "output = 'speed' is not known; type one of status, end_time"),
    ("outputs = 'speed'" + MAP, "outputs = 'speed' is no list of names"),
    ("", "the spec has no axes and gives no lanes"),
    ("[[axes]]\nname = 'slope'", "is not admissible; give it one of grid, values, zip"),
    ("[[axes]]\nvalues = [1]", "a values axis has no 'name'"),
    ("[[axes]]\nname = 'slope'\nvalues = []", "axis 'slope' has no values and gives zero lanes"),
    ("[[axes]]\nname = 'slop'\nvalues = [1]", "name of an axis = 'slop' is not known; type one of robot, plant, slope"),
    ("[[axes]]\nname = 'duration'\nvalues = [1]", "name of an axis = 'duration' is not known"),
    ("[[axes]]\nname = 'gains.c9'\nvalues = [1]", "axis 'gains.c9' leads to no number; type one of gains.c1"),
    ("[[axes]]\nname = 'slope'\ngrid = {from = 0, count = 3}", "grid of 'slope' has no 'to'"),
    ("[[axes]]\nname = 'slope'\ngrid = {from = 0, to = 1, count = 3, scale = 'cubic'}", "scale = 'cubic' is not known"),
    ("[[axes]]\nname = 'slope'\ngrid = 3", "grid of 'slope' = 3 is no table"),
    ("[[axes]]\nname = 'travel_deg'\nvalues = ['a']", "axis 'travel' has the values ['a']; type numbers"),
    ("[[axes]]\nuniform = {'slope' = [0, 1]}", "a uniform axis has no 'count'"),
    ("[[axes]]\nuniform = 3\ncount = 3", "uniform = 3 names no leaf"),
    (
        "[[axes]]\nzip = [{name = 'slope', values = [1, 2]}, {name = 'travel', values = [1]}]",
        "zipped axes must be equally long, but 'slope' has 2, 'travel' has 1",
    ),
]


@pytest.mark.parametrize(("text", "named"), FAULTS, ids=[text.replace("\n", " ")[:50] for text, _ in FAULTS])
def test_bad_specs_are_one_sentence_and_code_two(capsys, tmp_path, text, named):
    code, out, err = run(capsys, tmp_path, text)
    assert code == 2
    assert named in err
    assert err.count("\n") == 1
    assert out == ""
    assert not (tmp_path / "out" / "store").exists()


def test_a_missing_spec_and_resuming_nothing_are_named(capsys, tmp_path):
    assert cli.main(["sweep", str(tmp_path / "none.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "none.toml' cannot be read (No such file or directory); type a TOML file" in capsys.readouterr().err
    code, _, err = run(capsys, tmp_path, HEAD + MAP, "--resume")
    assert code == 2
    assert "holds no sweep to resume; start it without resume" in err


def test_ctrl_c_keeps_what_is_done_and_says_how_to_go_on(tmp_path):
    many = MAP.replace("count = 12", "count = 20000").replace("22", "15")
    (tmp_path / "spec.toml").write_text("chunk = 512" + HEAD + many)
    words = ["sweep", str(tmp_path / "spec.toml"), "--out", str(tmp_path / "out")]
    process = subprocess.Popen(
        [sys.executable, "-c", "import sys; from experiments.cli import main; sys.exit(main(sys.argv[1:]))", *words],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        # A shell that runs the tests in the background lets its children ignore interrupts.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    seen = b""
    while b"|" not in seen or b"1.02k/" not in seen:  # two chunks are done
        seen += process.stderr.read1(1000)
        assert process.poll() is None, seen
    assert b"lane/s" in seen
    err = b""
    for _ in range(5):  # Python drops an interrupt that meets it inside a finaliser
        process.send_signal(signal.SIGINT)
        try:
            _, err = process.communicate(timeout=4)
            break
        except subprocess.TimeoutExpired:
            continue
    assert process.returncode == 130
    last = err.decode().strip().splitlines()[-1]
    assert last.startswith("jaxsphere sweep: interrupted after ")
    assert last.endswith("of 100000 lanes; resume the same sweep to go on (resume=True or --resume)")
    assert len(list((tmp_path / "out" / "store" / "seals" / "sha256").glob("c.*"))) >= 2
    assert not list((tmp_path / "out" / "store").rglob(".*"))
