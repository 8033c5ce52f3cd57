# Everything a developer runs. Each target makes the environment if needed (scripts/setup-env).
export NO_MKDOCS_2_WARNING := 1
export PHYSCONVEX_VENV ?= $(CURDIR)/.venv
BIN := $(PHYSCONVEX_VENV)/bin
PACKAGES := physconvex models data_gen train inference

.PHONY: check quick static format test typecheck regression lock docs docs-serve bench bench-data bench-objects \
    checkpoint demo clean env

## check: format, lint, import contracts, types, documentation, then every test and doctest
check:
	scripts/check

## quick: the same with the quick tests only
quick:
	scripts/check quick

static:
	scripts/check static

format: env
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

env:
	@scripts/setup-env

## typecheck: the quick tests with shapes and annotations checked at run time
typecheck:
	./run-tests quick --typecheck

## docs: the site, in build/site; every link and every reference is checked
docs: env
	$(BIN)/python -m mkdocs build --quiet --strict

## docs-serve: the site at http://localhost:8000, made anew when a page changes
docs-serve: env
	$(BIN)/python -m mkdocs serve

## lock: pin the dependencies of pyproject.toml anew, with hashes, for every supported Python and platform
lock:
	uv pip compile pyproject.toml --extra dev --universal --python-version 3.11 --generate-hashes \
	    --no-emit-index-url --no-emit-find-links --no-header --quiet $(LOCK_OPTIONS) -o requirements.lock

## bench: speed, memory and label accuracy; results in benchmarks/results
bench: env
	@for name in generator friction_passes label_accuracy predict_throughput raster_limit raster_speed reduced_accuracy \
	    reduced_bases reduced_speed sand_passes; do \
	    echo "== $$name"; $(BIN)/python benchmarks/$$name.py || exit 1; done

## bench-data: what needs a data set: make bench-data DATA=data/drops
bench-data: env
	@for name in error_budget foreground known_states training_epoch; do \
	    echo "== $$name"; $(BIN)/python benchmarks/$$name.py --data $(DATA) || exit 1; done

## bench-objects: what needs a folder of scanned objects: make bench-objects OBJECTS=data/gso
bench-objects: env
	@for name in reconstruction gaussian_comparison moving_field; do \
	    echo "== $$name"; $(BIN)/python benchmarks/$$name.py --objects $(OBJECTS) || exit 1; done

## regression: results of the whole product compared with the stored ones (tests/regression/run.py)
regression: env
	$(BIN)/python tests/regression/run.py

## checkpoint: the recipe of the bundled checkpoint (docs/results/prediction.md); stop and start again as you like; needs a GPU
checkpoint: env
	$(BIN)/physconvex generate falls --out data/falls --shapes 1740 --seed 4101 --workers $$(nproc)
	$(BIN)/physconvex generate dataset --out data/drops --count 600 --seed 2101 --workers $$(nproc) --set camera.views=5
	$(BIN)/physconvex pretrain --falls data/falls --data data/drops --out runs/falls

demo:
	./run-demo

clean:
	rm -rf build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache demo_output
	find $(PACKAGES) tests -name __pycache__ -type d -prune -exec rm -rf {} +
