"""The walls of the house: who imports whom, and where each numbered equation lives."""

import ast
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
