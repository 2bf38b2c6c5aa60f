"""TOML specs of the command line."""

import numpy as np
import pytest

from experiments.cli.reproduce import robust_studies
from experiments.cli.simulate import COMMANDS as SIMULATE
from experiments.cli.spec import load_spec, take_spec
from experiments.cli.tune import COMMANDS as TUNE
from experiments.studies.robust import CASES

TunePlanar, SimulateSpatial = TUNE["tune planar"].options, SIMULATE["simulate spatial"].options


def written(folder, text):
    path = folder / "spec.toml"
    path.write_text(text)
    return str(path)


def test_a_spec_changes_what_it_names_and_nothing_else(tmp_path):
    text = 'out = "there"\n[robot]\nname = "rotunbot"\npendulum_mass = 70\n'
    text += '[tuning]\nstarts = 3\nfrozen = ["k"]\nsmoothing = [1, 0.5]'
    found = load_spec(TunePlanar(), written(tmp_path, text + "\n[uncertainty]\nslopes_deg = [1, 2.5]\nknown = false"))
    assert found.out == "there"
    assert found.robot.name == "rotunbot"
    assert found.robot.pendulum_mass == 70.0
    assert found.tuning.starts == 3
    assert found.tuning.frozen == ("k",)
    assert found.tuning.smoothing == (1.0, 0.5)
    assert found.uncertainty.slopes_deg == (1.0, 2.5)
    assert found.uncertainty.known is False
    assert found.gains == TunePlanar().gains
    assert TunePlanar().out == "out"
    other = load_spec(SimulateSpatial(), written(tmp_path, "[motion]\ntorque_limit = 3"))
    assert other.motion.torque_limit == 3.0


def test_shipped_specs_load():
    found = robust_studies()
    assert set(found) == set(CASES)
    for case, asked in found.items():
        assert asked["unlike"].scenarios == 16
        assert asked["unlike"].known is (case == "known")
        assert asked["unlike"].slopes == pytest.approx(np.deg2rad([5.0, 15.0 if case == "known" else 13.0]))
        assert (asked["initial"].k_i > 0.0) is (case == "unknown")


def test_the_spec_is_taken_off_the_words():
    assert take_spec(["--spec", "a.toml", "--out", "b"]) == ("a.toml", ["--out", "b"])
    assert take_spec(["--out", "b", "--spec=a.toml"]) == ("a.toml", ["--out", "b"])
    assert take_spec(["--out", "b"]) == (None, ["--out", "b"])
    with pytest.raises(ValueError, match="--spec needs a file"):
        take_spec(["--out", "b", "--spec"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[tuning]\nstart = 3", r"\[tuning\]: 'start' is no option here; type one of .*slope_deg, "),
        ("tuning = 3", r"tuning = 3 is no table; type \[tuning\] and its options below"),
        ("[tuning]\nstarts = 2.5", r"starts = 2.5 is not a whole number; type a whole number"),
        ("[tuning]\nstarts = true", "starts = True is not a whole number"),
        ("[tuning]\nexamine = 1", "examine = 1 is not true or false"),
        ('[tuning]\ntravel = "far"', "travel = 'far' is not a number"),
        ("[tuning]\nsmoothing = 0.2", "smoothing = 0.2 is no list"),
        ("[uncertainty]\nslopes_deg = [1.0]", r"slopes_deg = \[1.0\] has 1 entries; type 2"),
        ("[tuning", "is no TOML"),
        ("\ufeff\x00", "is no TOML"),
    ],
)
def test_a_faulty_spec_gets_one_sentence(tmp_path, text, message):
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        load_spec(TunePlanar(), path)
    assert path in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_spec_is_named(tmp_path):
    with pytest.raises(ValueError, match=r"none.toml' cannot be read"):
        load_spec(TunePlanar(), str(tmp_path / "none.toml"))
