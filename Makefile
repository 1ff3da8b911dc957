# Everything runs in .venv, made here on first use; nothing else needs to be installed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.installed-demo

export OMP_NUM_THREADS ?= 1
export PIP_DISABLE_PIP_VERSION_CHECK = 1
# Byte code is kept, whatever the environment says: the tests start hundreds of processes, and each would compile ours.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test lint bench docs docs-site wheel chaos chaos-live load soak fuzz images boot powercuts install clean

demo: $(DEMO_STAMP)
	$(BIN)/tuberline demo --out out/demo

test: $(STAMP)
	$(BIN)/python -m tests.kernels
	$(BIN)/python -m pytest -m "not slow" -n 4 --dist loadfile --no-loadscope-reorder

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Pages of docs/ and the model card, made from the code and from the results saved in docs/results.
docs: $(STAMP)
	$(BIN)/python -c 'from pathlib import Path; from tuberline.cli.reference import write_pages; write_pages(Path("docs"))'

# The same pages as a site in site/, without network.
docs-site: docs
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[docs]'
	$(BIN)/zensical build --strict

# The sdist and the wheel in dist/; its test, of `make test` too, installs them into an empty environment.
wheel: $(STAMP)
	$(BIN)/python -m hatchling build --directory dist
	$(BIN)/python -m pytest tests/tuberline/test_tuberline_wheel.py

# `make bench` lists the benchmarks, `make bench BENCH="site --help"` runs one.
bench: $(STAMP)
	$(BIN)/python -m benchmarks $(BENCH)

# Long ones, run by name.
chaos: $(STAMP)
	$(BIN)/python -m pytest -m slow tests/chaos

# A hundred live lines with random faults: an hour and a half. It goes on where it stopped; SEED=2 begins another hundred.
SEED ?= 1
chaos-live: $(STAMP)
	$(BIN)/python -m benchmarks chaos_live --runs 100 --seed $(SEED) --out out/chaos-live

load: $(STAMP)
	$(BIN)/python -m benchmarks load --minutes 30

fuzz: $(STAMP)
	TUBERLINE_FUZZ=20 $(BIN)/python -m pytest tests/fuzz
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[fuzz]'
	$(BIN)/python -m benchmarks fuzz --seconds 60

soak: $(STAMP)
	$(BIN)/python -m benchmarks soak --minutes 30

# As root, on a machine with Debian's tools: what deploy/ describes, built, run, booted and cut off. Each says what it
# needs and what it changes; the tables go into docs/deploy.md.
images boot powercuts: $(STAMP)
	$(BIN)/python -m deploy.trial.$@ $(TRIAL)

install: $(STAMP)

# torch first. On Linux the package index's own torch brings gigabytes of CUDA along: the CPU build of PyTorch's index is
# taken where that can be reached, and the other where it cannot. For a GPU: make install TORCH_INDEX=
ifeq ($(shell uname -s),Linux)
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
endif
TORCH = torch==2.13.0
$(DEMO_STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	test -n "$(TORCH_INDEX)" && $(BIN)/pip install --quiet --timeout 5 --retries 0 --no-deps --index-url $(TORCH_INDEX) $(TORCH) || { \
		test -z "$(TORCH_INDEX)" || echo "$(TORCH_INDEX) cannot be reached: torch from the package index instead"; \
		$(BIN)/pip install --quiet --constraint constraints.txt $(TORCH); }
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[viewer]'
	touch $@

$(STAMP): $(DEMO_STAMP)
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[viewer,clouds,bags,deploy,alarms,export,files,foxglove,map,report,sync,train,docs,dev]'
	touch $@

clean:
	rm -rf $(VENV) out runs
