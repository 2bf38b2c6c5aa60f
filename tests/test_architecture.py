"""The walls of the house: who imports whom, and where each numbered equation lives."""

import ast
import inspect
import re
import sys
from pathlib import Path

import pytest

import jaxsphere
import tuning

ROOT = Path(__file__).parent.parent
PACKAGES = ("jaxsphere", "tuning", "experiments")

# Part of jaxsphere -> the parts that it may import. A part is a folder, or a file directly below jaxsphere.
BASE = {"checks", "status", "files", "numerics", "identity", "units"}
MODELS = BASE | {"robot", "models"}
MAY_IMPORT = {
    **dict.fromkeys(BASE, BASE),
    "robot": BASE | {"robot"},
    "models": MODELS,
    "controllers": MODELS | {"controllers"},
    "simulation": MODELS | {"simulation"},
    "linear": MODELS | {"simulation", "linear"},
    "sweep": MODELS | {"simulation", "sweep"},
}
# Files that put the parts together.
UNRESTRICTED = {"__init__", "tasks"}

# (9) defines tanh and has no code of its own; (11) is the first half of the function of (12).
PLANAR_EQUATIONS = (1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 13, 14, 15, 16, 60)


def sources(package):
    """Every source file of a package with its syntax tree."""
    return [(path, ast.parse(path.read_text(encoding="utf-8"))) for path in sorted((ROOT / package).rglob("*.py"))]


def imported(tree):
    """Full names of everything that a file imports, wherever in the file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def part_of(path):
    """The part of jaxsphere that a file belongs to."""
    inside = path.relative_to(ROOT / "jaxsphere")
    return inside.parts[0] if len(inside.parts) > 1 else inside.stem


def test_the_walls_are_found():
    assert all(len(sources(package)) > 1 for package in PACKAGES)
    known = set(MAY_IMPORT) | UNRESTRICTED
    parts = {part_of(path) for path, _ in sources("jaxsphere")}
    assert parts <= known, "a new part of jaxsphere needs its rule here"


@pytest.mark.parametrize("part", sorted(MAY_IMPORT))
def test_parts_of_jaxsphere_import_in_one_direction(part):
    for path, tree in sources("jaxsphere"):
        if part_of(path) != part:
            continue
        for name in imported(tree):
            if name.split(".")[0] == "jaxsphere":
                assert name != "jaxsphere", f"{path} imports the whole package"
                assert name.split(".")[1] in MAY_IMPORT[part], f"{path} imports {name}"


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [
        ("jaxsphere", {"tuning", "experiments", "matplotlib", "tqdm", "tyro"}),
        ("tuning", {"experiments", "matplotlib", "tyro"}),
    ],
)
def test_packages_import_in_one_direction(package, forbidden):
    for path, tree in sources(package):
        tops = {name.split(".")[0] for name in imported(tree)}
        assert not tops & forbidden, f"{path} imports {tops & forbidden}"


@pytest.mark.parametrize("package", PACKAGES)
def test_nothing_beyond_the_declared_dependencies_is_imported_at_the_top(package):
    declared = {"jax", "jaxtyping", "numpy", "matplotlib", "tqdm", "tyro", *PACKAGES}
    for path, tree in sources(package):
        top_level = ast.Module([node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)], [])
        foreign = {name.split(".")[0] for name in imported(top_level)} - declared - set(sys.stdlib_module_names)
        assert not foreign, f"{path} imports {foreign}"


def test_controllers_know_no_time_step_and_models_no_controller():
    for path, tree in sources("jaxsphere"):
        if part_of(path) in ("models", "controllers"):
            names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
            arguments = {node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)}
            assert "dt" not in names | arguments, f"{path} knows dt"


def homes():
    """Equation number -> the functions whose summary claims it."""
    found = {}
    for path, tree in sources("jaxsphere"):
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                summary = (ast.get_docstring(node) or "").split("\n\n")[0]
                for number in re.findall(r"Eq\. \((\d+)\)", summary):
                    found.setdefault(int(number), []).append(f"{path.stem}.{node.name}")
    return found


def test_every_claimed_equation_has_exactly_one_home():
    claimed = homes()
    doubled = {number: places for number, places in claimed.items() if len(places) > 1}
    assert not doubled
    assert set(PLANAR_EQUATIONS) <= set(claimed)


def test_equation_eleven_is_named_in_the_home_of_twelve():
    (home,) = homes()[12]
    assert home == "sliding_mode.signals"
    text = (ROOT / "jaxsphere" / "controllers" / "sliding_mode.py").read_text(encoding="utf-8")
    functions = {node.name: node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)}
    assert "(11)" in ast.get_docstring(functions["signals"]).split("\n\n")[0]


def test_every_public_name_exists_and_is_documented():
    for package in (jaxsphere, tuning):
        assert len(set(package.__all__)) == len(package.__all__)
        for name in package.__all__:
            value = getattr(package, name)
            assert value is None or not callable(value) or value.__doc__, f"{package.__name__}.{name} has no docstring"


# Room of experiments -> the rooms that it may import.
EXPERIMENTS = {
    "records": set(),
    "plots": {"plots"},
    "studies": {"studies", "plots", "records"},
    "benchmarks": {"benchmarks", "plots", "records"},
    "cli": {"cli", "studies", "benchmarks", "plots", "records"},
}

# Words of the robot; simulation/ is for any plant. These files still have some: shorten the list, never lengthen it.
ROBOT_WORDS = {"alpha", "swing", "slope", "pendulum", "theta", "lean", "shell", "gimbal", "climb", "gains"}
STILL_KNOW_THE_ROBOT = {
    "bisection",
    "metrics",
    "refinement",
    "host",
    "rollout",
    "axes",
    "draws",
    "engine",
    "leaves",
    "results",
    "store",
}


def graph(package):
    """Module -> the modules of the same package that it imports, wherever in the file."""
    modules = {}
    for path, tree in sources(package):
        parts = path.relative_to(ROOT).with_suffix("").parts
        modules[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = tree
    found = {}
    for module, tree in modules.items():
        targets = {name if name in modules else name.rpartition(".")[0] for name in imported(tree)}
        found[module] = {name for name in targets if name in modules and name != module}
    return found


def circle(edges):
    """Return nodes of a directed graph that form a circle, [] if there is none."""
    left = dict(edges)
    while free := [node for node, targets in left.items() if not targets & set(left)]:
        for node in free:
            del left[node]
    if not left:
        return []
    node, path = next(iter(left)), []
    while node not in path:
        path.append(node)
        node = next(iter(left[node] & set(left)))
    return path[path.index(node) :]


def test_circles_are_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert set(circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()})) == {"b", "c"}


@pytest.mark.parametrize("package", PACKAGES)
def test_no_file_is_imported_in_a_circle(package):
    edges = graph(package)
    assert sum(map(len, edges.values())) > 10
    assert circle(edges) == []


@pytest.mark.parametrize("package", ["tuning", "experiments"])
def test_rooms_of_tuning_and_experiments_are_not_imported_in_a_circle(package):
    rooms = {}
    for module, targets in graph(package).items():
        if module != package:
            room = module.split(".")[1]
            rooms.setdefault(room, set()).update({name.split(".")[1] for name in targets if name != package} - {room})
    assert circle(rooms) == []


def test_experiments_go_from_the_command_line_to_studies_to_plots():
    seen = set()
    for module, targets in graph("experiments").items():
        if module == "experiments":
            continue
        room = module.split(".")[1]
        seen.add(room)
        assert {name.split(".")[1] for name in targets} <= EXPERIMENTS[room], module
    assert seen == set(EXPERIMENTS)


def test_only_plots_and_records_import_matplotlib_and_only_the_command_line_imports_tyro():
    for path, tree in sources("experiments"):
        room = path.relative_to(ROOT / "experiments").parts[0].removesuffix(".py")
        tops = {name.split(".")[0] for name in imported(tree)}
        assert "matplotlib" not in tops or room in ("plots", "records"), path
        assert "tyro" not in tops or room == "cli", path


def words_of(tree):
    """Lower-case words of the names, arguments and attributes of a file."""
    for node in ast.walk(tree):
        for name in (getattr(node, key, None) for key in ("id", "arg", "attr", "name")):
            if isinstance(name, str):
                yield from name.lower().split("_")


def test_simulation_knows_no_robot():
    knowing = {
        path.stem for path, tree in sources("jaxsphere") if part_of(path) == "simulation" and ROBOT_WORDS & set(words_of(tree))
    }
    assert knowing <= STILL_KNOW_THE_ROBOT


@pytest.mark.parametrize("package", PACKAGES)
def test_functions_fit_a_screen_and_files_are_short(package):
    for path, tree in sources(package):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 300, path
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                docstring = len((ast.get_docstring(node, clean=False) or "").splitlines())
                length = node.end_lineno - node.lineno + 1
                signature = node.body[0].lineno - node.lineno
                assert length - docstring - signature <= 60, f"{path}: {node.name} has {length - docstring - signature} lines"


def test_few_names_stand_at_the_top_and_those_to_begin_with_come_first():
    names = [name for name in jaxsphere.__all__ if not inspect.ismodule(getattr(jaxsphere, name))]
    assert len(names) == len(set(names)) <= 20
    assert jaxsphere.__all__[: len(names)] == names, "the modules come last"
    assert jaxsphere.__all__[:3] == ["Robot", "SlidingModeGains", "TrackingGains"]
