"""Maps of how steep: refinement equals the dense grid, coarse-to-fine equals lane by lane, and the command that draws them."""

import json

import numpy as np
import pytest

import jaxsphere as js
from experiments import cli
from experiments.studies import climbing_axes as axes
from experiments.studies import climbing_map as maps
from jaxsphere.sweep.refine import Boundaries
from jaxsphere.sweep.store import Store

QUICK = axes.Setting(numerics=js.Numerics(duration=60.0, dt=15e-3))


def refine(evaluate, shape, coarse):
    """Carry a plan out: outcomes of all nodes, and which of them were asked for."""
    plan = Boundaries(coarse=coarse).plan(shape)
    rows, columns, _ = next(plan)
    while True:
        try:
            rows, columns, _ = plan.send(evaluate(rows, columns))
        except StopIteration as stop:
            return stop.value


def disc(rows, columns):
    """Outcomes with curved boundaries between three classes."""
    away = np.hypot(rows - 40.3, columns - 61.7)
    return (away < 25.0).astype(int) + (away < 11.5)


@pytest.mark.parametrize(("shape", "coarse"), [((129, 129), 16), ((100, 141), 8), ((97, 130), 7)])
def test_refined_outcomes_equal_the_dense_ones_from_a_tenth_of_the_nodes(shape, coarse):
    seen = []

    def evaluate(rows, columns):
        seen.extend(zip(rows.tolist(), columns.tolist(), strict=True))
        return disc(rows, columns)

    found = refine(evaluate, shape, coarse)
    np.testing.assert_array_equal(found.outcomes, disc(*np.indices(shape)))
    assert len(seen) == len(set(seen)) == found.simulated.sum()
    assert found.simulated.size > 8 * found.simulated.sum()


def test_refinement_of_small_grids_and_of_one_outcome():
    for shape in ((1, 1), (1, 9), (2, 3), (5, 1)):
        checker = refine(lambda rows, columns: (rows + columns) % 2, shape, 1)
        np.testing.assert_array_equal(checker.outcomes, np.indices(shape).sum(axis=0) % 2)
    plain = refine(lambda rows, columns: np.full(len(rows), 7), (33, 33), 16)
    assert plain.simulated.sum() == 9
    assert np.all(plain.outcomes == 7)


def test_a_neighbour_uncovers_what_the_corners_hide():
    # A finger that enters a rectangle between its corners, seen only from the refined one beside it.
    def finger(rows, columns):
        return ((rows >= 12) | ((columns >= 3) & (columns <= 5) & (rows >= 4))).astype(int)

    found = refine(finger, (17, 17), 8)
    np.testing.assert_array_equal(found.outcomes, finger(*np.indices((17, 17))))


def test_map_from_coarse_to_fine_equals_every_bound_alone():
    x, y = axes.axis("z_u", 20, 0.75, 0.98), axes.axis("mass_ratio", 18, 0.35, 0.6)
    found = maps.bound_map(QUICK, x, y, 1e-3, progress=False)
    assert np.all(found.upper - found.lower <= 1e-3 * (1.0 + 1e-9))
    alone = js.batch(lambda xv, yv: js.slope_search(*axes.at(QUICK, z_u=xv, mass_ratio=yv), tolerance=1e-5), ragged=True)
    xv, yv = np.meshgrid(x.values, y.values)
    fine = np.asarray(alone(xv.ravel(), yv.ravel()).value).reshape(xv.shape)
    np.testing.assert_allclose(found.value, fine, atol=0.51e-3)
    assert found.rollouts < 5 * found.value.size  # 12 each without neighbours to begin at
    confirmed, asked = maps.confirm(QUICK, found, 4)
    assert confirmed == asked >= 4


def test_interrupted_map_goes_on_where_it_was(monkeypatch, tmp_path):
    x, y = axes.axis("z_u", 6, 0.8, 0.98), axes.axis("c1", 5)
    whole = maps.bound_map(QUICK, x, y, 1e-2, progress=False)
    remember, kept = Store.remember, []

    def interrupted(store, batch, record):
        remember(store, batch, record)
        kept.append(batch)
        if len(kept) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(Store, "remember", interrupted)
    with pytest.raises(KeyboardInterrupt, match=r"interrupted after .* lanes"):
        maps.bound_map(QUICK, x, y, 1e-2, progress=False, store=tmp_path / "map")
    monkeypatch.setattr(Store, "remember", lambda store, batch, record: (remember(store, batch, record), kept.append(batch)))
    found = maps.bound_map(QUICK, x, y, 1e-2, progress=False, store=tmp_path / "map", resume=True)
    assert kept == sorted(set(kept))  # nothing was computed twice
    np.testing.assert_array_equal(found.value, whole.value)


def test_mass_ratio_keeps_the_total_and_moves_the_bound_as_the_formula_says():
    robot = axes.at(QUICK, mass_ratio=0.3, length_ratio=0.5).task.robot
    assert robot.shell_mass + robot.gimbal_mass + robot.pendulum_mass == pytest.approx(5.1)
    assert js.climbing_bound(robot) == pytest.approx(np.arcsin(0.15))


def test_stable_step_keeps_the_smoothed_sign_stable():
    eta = axes.axis("eta", 3, 1.0, 10.0)
    assert axes.stable_step(QUICK) == 15e-3
    assert axes.stable_step(QUICK, eta) * 10.0 / 0.02 < 2.78
    assert axes.stable_step(axes.Setting(js.PlanarTask(smoothing=0.0, control_period=1e-3))) == 1e-3
    with pytest.raises(ValueError, match="control-period"):
        axes.stable_step(axes.Setting(js.PlanarTask(smoothing=0.0)))


def test_motor_is_blamed_only_where_a_stronger_one_settles():
    x, y = axes.axis("torque_limit", 5, 1.0, 3.0), axes.axis("slope", 5, 0.05, 0.32)
    found = maps.outcome_map(QUICK, x, y, coarse=None).outcome
    robot = js.Robot()
    weight = 5.1 * robot.gravity * robot.shell_radius
    held = weight * np.sin(y.values)[:, None] <= x.values[None, :]
    limited = found == maps.TORQUE_LIMITED
    assert limited.any()
    assert not np.any(limited & held & (y.values[:, None] < 0.25))
    assert np.all(limited[:4] == ~held[:4])
    assert np.all(found[4, 3:] == js.Status.DIVERGED)


def run(capsys, *words):
    """Run the command; return its exit code and what it printed."""
    code = cli.main(list(words))
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_map_command_writes_picture_numbers_and_manifest(capsys, tmp_path):
    words = ["map", "--x", "z_u", "--y", "torque_limit", "--size", "3", "--duration", "15", "--no-progress"]
    code, out, err = run(capsys, *words, "--out", str(tmp_path))
    assert code == 0, err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["manifest.json", "map.png", "map.zarr", "metrics.json"]
    numbers = json.loads((tmp_path / "metrics.json").read_text())["map"]
    assert numbers["bounds"] == 9
    assert "rollouts" in out
    saved = js.open_sweep(tmp_path / "map.zarr")
    assert saved.values["value"].shape == (3, 3)
    assert saved.dimensions == ("torque_limit", "z_u")
    assert json.loads((tmp_path / "manifest.json").read_text())["settings"]["dt"] == 15e-3


FAULTS = [
    (["--x", "weight"], "z_u"),
    (["--x", "c1", "--y", "c1"], "two different axes"),
    (["--y", "slope"], "--of outcome"),
    (["--of", "height"], "bound, outcome"),
    (["--size", "0"], "size = 0"),
    (["--tolerance", "0"], "tolerance = 0"),
    (["--x-range", "0.9", "0.2"], "z_u axis ends at = 0.2"),
    (["--x-range", "-0.1", "0.9"], "z_u axis reaches -0.1"),
    (["--x-range", "0.1", "1.5"], "z_u axis reaches 1.5"),
    (["--smoothing", "0"], "--control-period 1e-3"),
    (["--dtype", "float16"], "float32"),
    (["--y", "pendulum_length", "--y-range", "0.1", "0.2"], "pendulum_length axis reaches 0.2"),
    (["--of", "outcome", "--slope-deg", "95"], "--slope-deg = 95"),
    (["--travel", "0"], "travel = 0"),
    (["--duration", "0"], "duration = 0"),
]


@pytest.mark.parametrize(("words", "named"), FAULTS, ids=[" ".join(words) for words, _ in FAULTS])
def test_bad_input_is_one_sentence_and_code_two(capsys, tmp_path, words, named):
    code, out, err = run(capsys, "map", *words, "--out", str(tmp_path))
    assert code == 2
    assert err.count("\n") == 1
    assert named in err
    assert "Traceback" not in out + err
    assert list(tmp_path.iterdir()) == []
