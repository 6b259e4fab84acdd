# make demo: set everything up in .venv and run the main job on the embedded default.
# make test: set everything up in .venv and pass the whole check.
PYTHON ?= python3
BIN := .venv/bin
# The environment is made anew only when what it is made from has changed.
READY := .venv/ready-$(shell cat pyproject.toml constraints.txt | cksum | cut -d' ' -f1)
TYPED := --jaxtyping-packages=sightline,beartype.beartype

.PHONY: demo test format frames constraints clean

demo: $(READY)
	$(BIN)/sightline demo --out demo

# numba does not rebuild a cached kernel when one that it calls in another file has changed.
KERNELS := $(shell grep -rl --include='*.py' 'ops.compiled' src)

test: $(READY)
	find src -name '*.nb[ic]' ! -newer "$$(ls -t $(KERNELS) | head -n 1)" -delete
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest -n 2 --dist worksteal $(TYPED) --ignore tests/test_compiled.py
	$(BIN)/pytest tests/test_compiled.py

format: $(READY)
	$(BIN)/ruff check --fix-only .
	$(BIN)/ruff format .

# The frames that come with the package: whole files of the simulator, sweeps cut to the image.
FRAMES := src/sightline/simulation/frames
frames: $(READY)
	rm -rf build/frames $(FRAMES)
	$(BIN)/sightline simulate build/frames --frames 2 --seed 3 --velodyne velodyne_reduced
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
	rm -rf .venv demo build dist

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(0 if (3, 11) <= v < (3, 14) else \
		f"sightline needs Python 3.11 to 3.13, this is {v[0]}.{v[1]}: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv .venv
	rm -f .venv/ready-*
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@
