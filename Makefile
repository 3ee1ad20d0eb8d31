# Needs python3 (3.11 or newer) and make; `make test` and `make bench` need Node.js with npm and Chromium too and,
# on Linux, the tests Mesa's libEGL, which draws the pictures. Everything lands in .venv and .cache.
# ARGS is passed on: make run ARGS="--port 9000"; make test ARGS="tests/unit -k grid"; make lock ARGS=--upgrade;
# make bench ARGS="--only extraction"; make bench ARGS="compare HEAD~1"

PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input -qq install
# Wheels only: building from source would bring in build tools that no lock has pinned.
PIP_LOCKED := $(PIP) --require-hashes --only-binary :all:
UV_COMPILE := $(BIN)/uv pip compile --universal --python-version 3.11 \
	--generate-hashes --no-emit-index-url --no-header --quiet

RUNTIME := .venv/.runtime-installed
DEV := .venv/.dev-installed
NODE := tests/node_modules/.installed
WEB := clients/web/node_modules/.installed
VIEWER := clients/viewer/node_modules/.installed
CHROMIUM := .venv/.chromium-found
EGL := .venv/.egl-found

.PHONY: run test bench torture docs viewer lint format lock clean

run: $(RUNTIME)
	$(BIN)/chunkserver serve --data data $(ARGS)

test: lint $(NODE) $(WEB) $(VIEWER) $(CHROMIUM) $(EGL)
	$(BIN)/pytest $(ARGS)

torture: $(DEV) $(NODE) $(WEB) $(VIEWER) $(CHROMIUM) $(EGL)
	CHUNKSERVER_TORTURE=1 $(BIN)/pytest $(ARGS)

bench: $(DEV) $(NODE) $(CHROMIUM)
	$(BIN)/python -m benchmarks $(ARGS)

# What is generated in docs/. The pictures take about half a minute each: make docs ARGS="levels picture-planet mesh-canyon"
docs: $(DEV) $(EGL)
	$(BIN)/python -m pages $(ARGS)

# The page at /, which is committed as it is built: whoever runs the server needs no Node.js.
viewer: $(VIEWER)
	cd clients/viewer && npm run --silent build

lint: $(DEV)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy chunkserver tests benchmarks pages clients/python clients/loadtest

format: $(DEV)
	$(BIN)/python clients/python/write_async_client.py
	$(BIN)/ruff check --fix-only
	$(BIN)/ruff format

# The other two follow the dev lock, so that what runs is what was tested.
lock: $(DEV)
	$(UV_COMPILE) pyproject.toml --group dev --output-file requirements-dev.lock $(ARGS)
	$(UV_COMPILE) pyproject.toml --constraint requirements-dev.lock --output-file requirements.lock
	$(UV_COMPILE) --group build --constraint requirements-dev.lock --output-file requirements-build.lock

clean:
	rm -rf .venv .cache tests/node_modules build dist clients/web/node_modules clients/web/dist clients/web/.test clients/viewer/node_modules
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(RUNTIME): pyproject.toml requirements.lock requirements-build.lock
	@$(PYTHON) -c 'import sys; sys.exit("chunkserver needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv .venv
	$(PIP_LOCKED) -r requirements.lock -r requirements-build.lock
	$(PIP) --no-deps --no-build-isolation --editable .
	touch $@

$(DEV): $(RUNTIME) requirements-dev.lock clients/python/pyproject.toml clients/loadtest/pyproject.toml
	$(PIP_LOCKED) -r requirements-dev.lock
	$(PIP) --no-deps --no-build-isolation --editable clients/python --editable clients/loadtest
	touch $@

$(NODE): tests/package.json tests/package-lock.json
	@command -v npm >/dev/null || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
		&& apt-get -qq update && apt-get -qq install --yes nodejs npm; } \
		|| { echo "make test needs Node.js with npm: please install it first" >&2; exit 1; }
	cd tests && npm ci --no-audit --no-fund --loglevel=error
	touch $@

$(WEB): clients/web/package.json clients/web/package-lock.json $(NODE)
	cd clients/web && npm ci --no-audit --no-fund --loglevel=error
	touch $@

$(VIEWER): clients/viewer/package.json clients/viewer/package-lock.json $(NODE)
	cd clients/viewer && npm ci --no-audit --no-fund --loglevel=error
	touch $@

$(CHROMIUM): $(DEV)
	@command -v chromium >/dev/null || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
		&& apt-get -qq update && apt-get -qq install --yes chromium; } \
		|| { echo "the viewer is tested in Chromium: please install it first (Debian: chromium)" >&2; exit 1; }
	touch $@

$(EGL): $(DEV)
	@[ "$$(uname)" != Linux ] || $(BIN)/python -c 'import ctypes; ctypes.CDLL("libEGL.so.1")' 2>/dev/null \
		|| { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null \
		&& apt-get -qq update && apt-get -qq install --yes libegl1 libgl1-mesa-dri; } \
		|| { echo "pictures are drawn by Mesa: please install its libEGL first (Debian: libegl1 libgl1-mesa-dri)" >&2; exit 1; }
	touch $@
