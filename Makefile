# Every target makes the virtual environment it needs: a clone, Python 3.11 and make are enough.
# `test-blender` and `test-oldest` need Python 3.11 itself, for Blender as a module and for old versions
# of libraries, and `test-browser` needs Chromium;
# nothing else here depends on them.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
PLAIN  := $(VENV)/.installed
READY  := $(VENV)/.ready
KERNEL := $(wildcard cageik_cli/kernel/*)
OUT    ?= out
DIST   := $(OUT)/dist

PYTHON311     ?= python3.11
BLENDER_VENV  ?= .venv-blender
BLENDER_READY := $(BLENDER_VENV)/.ready
READ_BACK     := $(BLENDER_VENV)/bin/python tests/blender/read_back.py $(OUT)/blender

OLDEST_VENV   ?= .venv-oldest
OLDEST_READY  := $(OLDEST_VENV)/.ready

CHROMIUM      ?= chromium

# One worker per processor, each with whole files for as long as there are any: fixtures are made once.
PARALLEL      := --numprocesses=auto --dist=worksteal
PYTEST        := $(BIN)/python -m pytest $(PARALLEL)

# The compiled tests and modules are kept for the next run.
unexport PYTHONDONTWRITEBYTECODE

SANITIZED     := $(OUT)/sanitized
# As a call, memcpy is checked to the byte; inlined, a word that begins inside an array may end behind it.
SANITIZE      := -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -fno-builtin-memcpy
PURE_TESTS    := tests/method tests/captured tests/fit tests/formats/obj tests/formats/test_find_files.py tests/formats/test_fuzz_readers.py tests/cages/test_bind.py tests/run/test_bind.py tests/run/test_extraction.py tests/geometry tests/test_fixtures.py
SCRIPT_TYPES  := --ignoreConfig --allowJs --checkJs --noEmit --strict false --target es2022 --lib es2022,dom,dom.iterable
KERNEL_TESTS  := tests/method/weights/bem tests/method/weights/test_harmonic.py tests/formats/obj tests/formats/test_fuzz_readers.py tests/geometry/test_surface.py tests/report/render/test_raster.py tests/method/solve/test_compiled_frames.py tests/method/solve/test_summary.py

.PHONY: help run test test-slow test-all test-pure test-oldest sanitize test-blender test-gltf test-browser check check-script format fuzz faults bench growth latency dist docs fixtures view-pictures clean

help:  ## Show the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1	/p' $(MAKEFILE_LIST) | expand -t 14

# `run` installs what a user needs; what tests and checks need on top comes with `.ready`.
$(PLAIN): pyproject.toml $(KERNEL)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(READY): pyproject.toml $(KERNEL)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $(PLAIN) $@

run: $(PLAIN)  ## Extract the walking figure, in a cage by hand and in a built one, and report on both
	@mkdir -p $(OUT)
	$(BIN)/cageik extract data_fixtures/walker/frames/*.obj --cage data_fixtures/walker/cage.obj \
		--output $(OUT)/walker.h5 --overwrite
	$(BIN)/cageik report $(OUT)/walker.h5 --html $(OUT)/walker.html --plot $(OUT)/figure4.png \
		--json $(OUT)/report.json --csv $(OUT)/frames.csv --overwrite
	$(BIN)/cageik extract data_fixtures/walker/frames/*.obj --output $(OUT)/walker-built.h5 \
		--cage-out $(OUT)/built_cage.obj --overwrite
	$(BIN)/cageik report $(OUT)/walker-built.h5 --html $(OUT)/walker-built.html --overwrite
	@echo "open $(abspath $(OUT))/walker.html, or walker-built.html for the cage that was built"

test: $(READY)  ## Run the quick tests, with the coverage of the package
	$(PYTEST) --cov --cov-report=term-missing:skip-covered --cov-fail-under=95

test-slow: $(READY)  ## Run the tests that `test` leaves out: clusters, killed batches, many cages
	$(PYTEST) -m slow

test-all: test test-slow  ## Run all tests

test-pure: $(READY)  ## Run the tests of weights and readers without the compiled core
	CAGEIK_PURE=1 $(PYTEST) $(PURE_TESTS)

$(OLDEST_READY): pyproject.toml tests/oldest.py $(KERNEL)
	@$(PYTHON311) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null || { \
		echo "$(PYTHON311): is not Python 3.11, the oldest that is stated; install it, or name it:" \
			"make test-oldest PYTHON311=/path/to/python3.11" >&2; exit 1; }
	$(PYTHON311) -m venv $(OLDEST_VENV)
	$(OLDEST_VENV)/bin/python tests/oldest.py > $(OLDEST_VENV)/oldest.txt
	$(OLDEST_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]' \
		--constraint $(OLDEST_VENV)/oldest.txt
	@touch $@

test-oldest: $(OLDEST_READY)  ## Run the quick tests with the oldest libraries that pyproject.toml allows
	$(OLDEST_VENV)/bin/python -m pytest $(PARALLEL)

# The sanitizers are in the process before Python is, and so before all that it allocates.
sanitize: $(READY)  ## Run the tests of the compiled core under the sanitizers of the compiler
	rm -rf $(SANITIZED)
	mkdir -p $(SANITIZED)
	cp -r cageik_cli tests data_fixtures pyproject.toml $(SANITIZED)
	$(CC) -std=c11 -O1 -g -Wall -Wextra -Werror $(SANITIZE) -DCAGEIK_ONE_TARGET -fPIC -shared \
		-I"$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_paths()["include"])')" \
		cageik_cli/kernel/*.c -o $(SANITIZED)/cageik_cli/_kernel.abi3.so -lm
	cd $(SANITIZED) && env ASAN_OPTIONS=detect_leaks=0 PYTHONMALLOC=malloc OPENBLAS_NUM_THREADS=1 \
		LD_PRELOAD="$$($(CC) -print-file-name=libasan.so) $$($(CC) -print-file-name=libstdc++.so)" \
		$(abspath $(BIN))/python -m pytest --capture=sys -m "not slow and not bench" $(KERNEL_TESTS)

$(BLENDER_READY):
	@$(PYTHON311) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null || { \
		echo "$(PYTHON311): is not Python 3.11, which bpy 5.0.1 needs; install it, or name it:" \
			"make test-blender PYTHON311=/path/to/python3.11" >&2; exit 1; }
	$(PYTHON311) -m venv $(BLENDER_VENV)
	$(BLENDER_VENV)/bin/python -m pip install --quiet --disable-pip-version-check bpy==5.0.1 'numpy<2'
	@touch $@

test-blender: $(BLENDER_READY) $(READY)  ## Read every format back in Blender, and let cages move models there
	@mkdir -p $(OUT)/blender
	$(BIN)/python tests/blender/write.py $(OUT)/blender
	$(READ_BACK) --wrong > $(OUT)/blender/wrong.log
	$(READ_BACK) > $(OUT)/blender/imports.log
	$(BIN)/python tests/blender/write_assets.py $(OUT)/blender
	$(BLENDER_VENV)/bin/python tests/blender/read_assets.py $(OUT)/blender >> $(OUT)/blender/imports.log
	$(BIN)/python tests/blender/write_parts.py $(OUT)/blender
	$(BLENDER_VENV)/bin/python tests/blender/read_parts.py $(OUT)/blender >> $(OUT)/blender/imports.log
	$(BIN)/python tests/blender/write_posed.py $(OUT)/blender
	$(BLENDER_VENV)/bin/python tests/blender/read_posed.py $(OUT)/blender >> $(OUT)/blender/imports.log
	$(BLENDER_VENV)/bin/python tests/blender/write_rig.py $(OUT)/blender docs/scripts/bake_rig.py >> $(OUT)/blender/imports.log
	$(BIN)/python tests/blender/read_rig.py $(OUT)/blender
	$(BIN)/python tests/blender/write_live.py $(OUT)/blender
	$(BLENDER_VENV)/bin/python tests/blender/read_live.py $(OUT)/blender >> $(OUT)/blender/imports.log
	$(BIN)/python tests/blender/deform_live.py $(OUT)/blender

test-gltf: $(READY)  ## Validate every .glb that tests write by the Khronos validator; needs npm
	@command -v npm >/dev/null || { echo "npm: no such program; install Node.js, which has it" >&2; exit 1; }
	npm install --silent --no-audit --no-fund --no-save --prefix build/gltf gltf-validator@2.0.0-dev.3.10
	$(PYTEST) -m "not slow and not bench" tests/formats tests/cli tests/run

test-browser: $(READY)  ## Open the pages and textures in Chromium, by mouse and keyboard; needs npm
	@command -v $(CHROMIUM) >/dev/null || { \
		echo "$(CHROMIUM): no such program; install Chromium or Chrome, or name it:" \
			"make test-browser CHROMIUM=/path/to/chrome" >&2; exit 1; }
	@command -v npm >/dev/null || { echo "npm: no such program; install Node.js, which has it" >&2; exit 1; }
	npm install --silent --no-audit --no-fund --no-save --prefix build/browser three@0.187.0 fast-png@8.0.0
	$(BIN)/python -m pip install --quiet --disable-pip-version-check playwright axe-playwright-python
	CHROMIUM="$$(command -v $(CHROMIUM))" $(BIN)/python -m pytest tests/browser -m browser

check: $(READY)  ## Format, lint, types, who imports what, and the rules of CONTRIBUTING.md
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy --strict docs/scripts/walker_to_glb.py
	$(BIN)/lint-imports
	$(BIN)/python -m tests.rules

check-script:  ## Check the types of the scripts of pages; needs npm
	@command -v npm >/dev/null || { echo "npm: no such program; install Node.js, which has it" >&2; exit 1; }
	npm install --silent --no-audit --no-fund --no-save --prefix build/script typescript@7.0.2
	build/script/node_modules/.bin/tsc $(SCRIPT_TYPES) \
		$(addprefix cageik_cli/view/templates/, player.d.ts player/*.js)

format: $(READY)  ## Format the code and sort the imports
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

fuzz: $(READY)  ## Try more random cages than the tests have time for
	$(PYTEST) -m fuzz

# FAULT_SECONDS=300 tries as many faults, in random order, as that takes; FAULT_KILLS=20 kills fewer runs.
faults: $(READY)  ## Let every call of every command fail, and kill runs (half an hour; Linux, x86-64)
	$(BIN)/python -m pytest tests/faults -m faults -s

bench: $(READY)  ## Measure speed against yardsticks, as ratios
	$(BIN)/python -m pytest tests/benchmarks -m bench -s

growth: $(READY)  ## Measure how a bind grows with cage and model (takes minutes)
	@mkdir -p $(OUT)
	$(BIN)/python -m tests.benchmarks.growth $(OUT)/growth.png

latency: $(READY)  ## Measure how long a move of anchors takes over the size of the model
	@mkdir -p $(OUT)
	$(BIN)/python -m tests.benchmarks.latency $(OUT)/latency.png

# The wheel is built from the source distribution, and tried by itself: -I keeps this folder off the path.
dist:  ## Build the distributions, and try the wheel in an environment of its own
	rm -rf dist $(DIST)
	$(PYTHON) -m venv $(DIST)/tools
	$(DIST)/tools/bin/python -m pip install --quiet --disable-pip-version-check build twine uv
	$(DIST)/tools/bin/python -m build --outdir dist
	$(DIST)/tools/bin/twine check --strict dist/*
	$(PYTHON) -m venv $(DIST)/bare
	$(DIST)/bare/bin/python -m pip install --quiet --disable-pip-version-check dist/*.whl
	cd $(DIST) && bare/bin/python -I $(CURDIR)/tests/dist_smoke.py $(CURDIR)
	cd $(DIST) && tools/bin/uvx --from $(CURDIR)/dist/*.whl cageik --version

docs: $(READY)  ## Build the documentation site, strictly
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir $(OUT)/site

fixtures: $(READY)  ## Make data_fixtures again, byte for byte, and the pictures
	$(BIN)/python data_fixtures/make_fixtures.py
	$(BIN)/python data_fixtures/make_picture.py
	$(BIN)/python data_fixtures/make_pose_pictures.py
	$(BIN)/python data_fixtures/make_quality_pictures.py
	$(BIN)/python data_fixtures/make_rig_pictures.py
	$(BIN)/python -m tests.splats_picture data_fixtures/pictures/splats.png
	@mkdir -p $(OUT)
	$(BIN)/cageik cage data_fixtures/walker/frames/walker_1.obj -o $(OUT)/built_cage.obj --overwrite
	$(BIN)/cageik check --cage $(OUT)/built_cage.obj --rest data_fixtures/walker/frames/walker_1.obj \
		--plot data_fixtures/pictures/built_cage.png --overwrite
	$(BIN)/cageik cage data_fixtures/walker/frames/walker_1.obj -o $(OUT)/looped_cage.obj --quads --loops --overwrite
	$(BIN)/cageik check --cage $(OUT)/looped_cage.obj --rest data_fixtures/walker/frames/walker_1.obj \
		--plot data_fixtures/pictures/looped_cage.png --overwrite
	$(BIN)/python -c "import sys; from PIL import Image; \
		[Image.open(p).convert('RGB').quantize(64).save(p, optimize=True) for p in sys.argv[1:]]" \
		data_fixtures/pictures/built_cage.png data_fixtures/pictures/looped_cage.png

view-pictures: $(READY)  ## Draw the pictures of `cageik view` again, in Chromium
	$(BIN)/python -m pip install --quiet --disable-pip-version-check playwright axe-playwright-python
	$(BIN)/python data_fixtures/make_view_pictures.py "$$(command -v $(CHROMIUM))"

clean:  ## Remove what was built and written here
	rm -rf $(VENV) $(BLENDER_VENV) $(OLDEST_VENV) $(OUT) build dist *.egg-info cageik_cli/_kernel.*.so cageik_cli/_kernel.*.pyd .pytest_cache .mypy_cache .ruff_cache .coverage .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
