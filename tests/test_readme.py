"""The README's example runs, and the files it names exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_example_runs_and_prints_what_its_comments_say(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    scope = {}
    exec(compile(example, "README.md", "exec"), scope)
    printed = capsys.readouterr().out.split()
    assert abs(float(printed[0]) - 18.76) < 0.01
    assert abs(float(printed[1]) - 6.36) < 0.01
    status = scope["js"].Status
    lanes = [status(int(code)) for code in scope["lanes"]]
    # Slopes of 19, 19.5 and 20 degrees are past the bound.
    assert [lane is status.INFEASIBLE_LEAN for lane in lanes] == [False] * 38 + [True] * 3
    assert scope["result"].objective < scope["result"].initial_objective


def test_named_files_exist():
    named = set(re.findall(r"\b(?:jaxsphere|tuning|experiments|tests|notebooks)/[\w/]*\.(?:py|png|ipynb|toml)", README))
    assert len(named) >= 10
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []
