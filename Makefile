# make demo: set everything up in .venv and run the main job on the embedded default (100 seconds).
# make test: set everything up in .venv and pass the whole check.
# make docs: build the site into build/site.
# make package: build the archives of a release into build/package, and run the wheel.
# make results: write the tables of docs/results from benchmarks/results.
# make test-all: run the tests on every Python that is promised and to be found here.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# The environment is made anew only when what it is made from has changed.
READY := $(VENV)/ready-$(shell cat pyproject.toml constraints.txt | cksum | cut -d' ' -f1)
PROMISED := $(shell sed -n 's/.*Programming Language :: Python :: \(3\.[0-9]*\)".*/\1/p' pyproject.toml)
# Compiled modules are kept for the next process; some images of Python set this to 1.
export PYTHONDONTWRITEBYTECODE :=
TYPED := --jaxtyping-packages=sightline,beartype.beartype

.PHONY: demo test lint docs results package kernels tests compiled test-all format frames \
	constraints clean

demo: $(READY)
	$(BIN)/sightline demo --out demo
	@echo "Break a sensor in the browser: $(BIN)/sightline serve"

# numba does not rebuild a cached kernel when one that it calls in another file has changed.
KERNELS := $(shell grep -rl --include='*.py' 'ops.compiled' src)

# What runs on one core goes two at a time; the tests take both cores.
test: $(READY)
	$(MAKE) --jobs 2 lint docs compiled
	$(MAKE) tests

lint: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The page that the documentation shows; what is there already is not computed again.
PLAY := --kinds lidar_beams --severities 1 2 3 4 5

# Whatever warns, a link that leads nowhere say, fails the build.
docs: $(READY)
	$(BIN)/sightline serve --export build/play --engine torch $(PLAY)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict  # with --quiet no warning would count

results: $(READY)
	$(BIN)/python -m benchmarks.tables

# The wheel is installed by itself; its dependencies are those of the environment here, without the
# source, as a path that a .pth file adds is not searched for further .pth files.
WHEEL := build/package/venv
PLACE := import sysconfig; print(sysconfig.get_path("purelib"))
package: $(READY)
	rm -rf build/package
	$(BIN)/python -m build --no-isolation --outdir build/package
	$(BIN)/twine check --strict build/package/*
	$(BIN)/python -m venv --without-pip $(WHEEL)
	$(BIN)/python -m pip --python $(WHEEL)/bin/python install --quiet --no-index --no-deps build/package/*.whl
	$(BIN)/python -c '$(PLACE)' > "$$($(WHEEL)/bin/python -c '$(PLACE)')/dependencies.pth"
	cd build/package && unset PYTHONPATH && venv/bin/sightline --version && venv/bin/sightline tasks \
		&& venv/bin/sightline check "$$(venv/bin/python -c \
			'from sightline.simulation.packaged import PACKAGED_FRAMES; print(PACKAGED_FRAMES)')"

kernels:
	find src -name '*.nb[ic]' ! -newer "$$(ls -t $(KERNELS) | head -n 1)" -delete

tests: $(READY) kernels
	$(BIN)/pytest -n 2 --dist worksteal --durations 25 $(TYPED) --ignore tests/test_compiled.py

compiled: $(READY) kernels
	$(BIN)/pytest tests/test_compiled.py

# A Python is python3.N on the path, or one of pyenv's; each has an environment of its own.
test-all:
	@skipped=; \
	for version in $(PROMISED); do \
		found=; \
		for python in python$$version "$${PYENV_ROOT:-$$HOME/.pyenv}"/versions/$$version.*/bin/python; do \
			"$$python" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$$version')" \
				2> /dev/null && found=$$python && break; \
		done; \
		if [ -z "$$found" ]; then skipped="$$skipped $$version"; continue; fi; \
		echo "== Python $$version: $$found"; \
		$(MAKE) tests compiled PYTHON="$$found" VENV=.venv-$$version || exit; \
	done; \
	test -z "$$skipped" || echo "== skipped, as they are not installed:$$skipped"

format: $(READY)
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

# The frames that come with the package: whole files of the simulator, sweeps cut to the image.
FRAMES := src/sightline/simulation/frames
frames: $(READY)
	rm -rf build/frames $(FRAMES)
	$(BIN)/sightline simulate build/frames --frames 2 --seed 15 --velodyne velodyne_reduced
	mkdir -p $(FRAMES)/training
	mv build/frames/ImageSets $(FRAMES)/ImageSets
	for part in image_2 calib label_2 depth; do mv build/frames/training/$$part $(FRAMES)/training; done
	mv build/frames/training/velodyne_reduced $(FRAMES)/training/velodyne

# The newest releases that fit pyproject.toml, for every supported Python and platform in one file.
constraints: $(READY)
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --universal --upgrade --all-extras --no-annotate --no-header \
		--python-version 3.11 --output-file constraints.txt pyproject.toml

clean:
	rm -rf .venv .venv-* demo build dist

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v < (3, 14) else \
		f"sightline needs Python 3.11 to 3.13, this is {v[0]}.{v[1]}: make PYTHON=python3.12 ...")'
	@echo "Installing Sightline and its dependencies into $(VENV): minutes, and up to 7 GB with CUDA"
	$(PYTHON) -m venv $(VENV)
	rm -f $(VENV)/ready-*
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt \
		--editable '.[dev]'
	touch $@
