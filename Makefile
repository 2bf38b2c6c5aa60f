# Two commands do everything on a machine with Python 3.11+ and make: `make reproduce` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out

.PHONY: reproduce test slowest lint notebooks bench clean

reproduce: $(VENV)/run
	$(BIN)/jaxsphere reproduce --out $(OUT)

test: $(VENV)/dev
	$(BIN)/python -m pytest -n 2 --dist loadfile

slowest: $(VENV)/dev
	$(BIN)/python -m pytest -n 2 --dist loadfile --durations 10

lint: $(VENV)/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

notebooks: $(VENV)/dev
	$(BIN)/python -m pytest -n 2 --nbmake --nbmake-timeout=300 --override-ini=testpaths=notebooks notebooks

bench: $(VENV)/dev
	$(BIN)/pip install --quiet --editable '.[bench]'
	$(BIN)/jaxsphere bench --case planar --out $(OUT)

# The markers are younger than pyproject.toml while the environment fits it.
$(VENV)/run: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("jaxsphere needs Python 3.11 or newer; type make PYTHON=python3.11" if sys.version_info < (3, 11) else 0)'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	touch $@

$(VENV)/dev: $(VENV)/run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) $(OUT)
