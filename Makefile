# make serve   serve the committed models on http://127.0.0.1:8000 (PORT=9000 make serve)
# make test    format, lint, types, architecture and every test
#
# Both need Python 3.11 or newer (PYTHON=/path/to/python3.11) and make the environments they run in.

PORT ?= 8000
UV_VERSION := 0.13.9

# Tests in these folders run where torch cannot be imported; all others run in .venv/test.
TORCH_FREE_TESTS := $(wildcard tests/service tests/contract)
# Other people's clients have an environment of their own, and so has every framework of make bench.
PROTOCOL_TESTS := tests/protocol
# Those of the images take long, need root and tools of Debian's: make image-test.
IMAGE_TESTS := tests/image
# Those of a cluster of Ray's take long too, and Ray warns of much: make cluster-test.
CLUSTER_TESTS := tests/cluster
# Those of the page need Debian's chromium: make browser-test.
BROWSER_TESTS := tests/browser
# What is tried beyond make test, of which docs/reliability.md has the figures.
FUZZ_SHARE ?= 1
# Six replicas start on fewer cores: Ray would give its proxy up after 5 s.
ON_RAY := RAY_SERVE_PROXY_READY_CHECK_TIMEOUT_S=60
PEERS := peer-fastapi peer-litserve peer-bentoml peer-ray

export PYTHON
export TORCH_INSTALL_ARGS
# No step looks for newer releases or reports to anyone.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1
export ORT_DISABLE_TELEMETRY := 1
export RAY_USAGE_STATS_ENABLED := 0

BIN := .venv/test/bin
PYTEST_ARGS ?=
# Processes that run the tests side by side, a file at a time, each on one core.
PROCESSES ?= 2
SIDE_BY_SIDE = OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(PROCESSES) --dist loadfile

# $(call step,NAME,COMMAND): one line before the command, and one that says which step failed.
define step
	@printf -- '--- %s\n' '$(1)'; $(2) || { printf 'rollcast: FAILED: %s\n' '$(1)' >&2; exit 1; }
endef

.PHONY: help serve test docs bench browser-test image-test cluster-test scaling fuzz fuzz-api mutate faults soak sbom licences format lint environments lock clean
.NOTPARALLEL:

help:
	@echo 'make serve    serve the committed models on http://127.0.0.1:8000 (PORT=... picks another port)'
	@echo 'make test     run every check and test'
	@echo 'make docs     build the documents into build/docs, check every link, execute the notebook'
	@echo 'make bench    measure the service beside the bare loop; on a machine that does nothing else'
	@echo 'make browser-test  try the page in a real browser; needs Debian'"'"'s chromium'
	@echo 'make image-test  build the images and try them; needs root, debootstrap, buildah and podman'
	@echo 'make cluster-test  try the service on Ray: replicas and nodes are killed under load'
	@echo 'make scaling  measure the service on Ray, on a machine that does nothing else'
	@echo 'make fuzz     any bytes into every reader of input, millions of times; FUZZ_SHARE=0.01 for fewer'
	@echo 'make fuzz-api  what the description allows, and what it does not, to every route of the real service'
	@echo 'make mutate   how many changed lines of the core the tests notice'
	@echo 'make faults   processes killed, disks full, clocks moved, clients deaf: what a service under load does'
	@echo 'make soak     100,000 mixed requests and 5,000 simulations: memory, descriptors, times'
	@echo 'make sbom     what the images are made of, as CycloneDX files in build/'
	@echo 'make licences the licences of that, into docs/licences.md'
	@echo 'make format   format the code'
	@echo 'make lint     the checks of make test without its tests'
	@echo 'make lock     compile requirements/*.txt anew from pyproject.toml (UPGRADE=1: newest versions)'
	@echo 'make clean    remove environments and caches'

serve:
	@tools/environment.sh service
	@exec .venv/service/bin/python -m service --host 127.0.0.1 --port $(PORT)

test: environments lint
	$(call step,tests,$(SIDE_BY_SIDE) tests $(TORCH_FREE_TESTS:%=--ignore=%) $(PROTOCOL_TESTS:%=--ignore=%) $(IMAGE_TESTS:%=--ignore=%) $(CLUSTER_TESTS:%=--ignore=%) $(BROWSER_TESTS:%=--ignore=%) $(PYTEST_ARGS))
	$(call step,no torch in the service environment,! .venv/service/bin/python -c 'import torch' 2>/dev/null)
	$(call step,tests without torch,.venv/service-test/bin/python -m pytest $(or $(TORCH_FREE_TESTS),tests/service) $(PYTEST_ARGS))
	$(call step,clients of the protocol,.venv/protocol/bin/python -m pytest $(PROTOCOL_TESTS) $(PYTEST_ARGS))
	@echo 'rollcast: every check and test passed'

docs:
	@tools/environment.sh service
	@tools/environment.sh docs
	$(call step,site,.venv/docs/bin/python -m sphinx --quiet --fail-on-warning --keep-going -d build/doctrees docs build/docs)
	$(call step,links,.venv/docs/bin/lychee --offline --include-fragments=full --no-progress 'build/docs/**/*.html')
	$(call step,notebook,.venv/docs/bin/python -m docs.notebook --check)
	@echo 'rollcast: build/docs/index.html'

bench:
	@tools/environment.sh service
	@for name in bench $(PEERS); do tools/environment.sh $$name || exit 1; done
	@.venv/bench/bin/python -m tests.bench.run $(BENCH_ARGS)

browser-test:
	@tools/environment.sh service
	@tools/environment.sh browser
	$(call step,page,.venv/browser/bin/python -m pytest $(BROWSER_TESTS) $(PYTEST_ARGS))

image-test:
	@tools/environment.sh service
	@tools/environment.sh image
	$(call step,images,.venv/image/bin/python -m pytest $(IMAGE_TESTS) $(PYTEST_ARGS))

cluster-test:
	@tools/environment.sh service
	@tools/environment.sh cluster --torch
	$(call step,cluster,$(ON_RAY) .venv/cluster/bin/python -m pytest -W ignore $(CLUSTER_TESTS) $(PYTEST_ARGS))

scaling:
	@tools/environment.sh service
	@tools/environment.sh cluster --torch
	@$(ON_RAY) .venv/cluster/bin/python -W ignore -m tests.cluster.scaling $(SCALING_ARGS)

fuzz:
	@tools/environment.sh fuzz
	@.venv/fuzz/bin/python -m tests.fuzz.run --share $(FUZZ_SHARE)

fuzz-api:
	@tools/environment.sh service
	@tools/environment.sh test --torch
	@$(BIN)/python -m tests.fuzz.api

mutate:
	@tools/environment.sh mutation
	@.venv/mutation/bin/python -m tests.mutation.run $(MUTATE_ARGS)

faults:
	@tools/environment.sh service
	@tools/environment.sh bench
	@.venv/bench/bin/python -m tests.faults.run $(FAULTS_ARGS)

soak:
	@tools/environment.sh service
	@tools/environment.sh bench
	@.venv/bench/bin/python -m tests.soak.serve_long $(SOAK_ARGS)

sbom:
	@tools/environment.sh supply
	@mkdir -p build
	@for name in service ray training; do \
		.venv/supply/bin/cyclonedx-py requirements requirements/$$name.txt --pyproject pyproject.toml \
			--mc-type application --output-reproducible --sv 1.6 -o build/sbom-$$name.json || exit 1; \
		echo "rollcast: build/sbom-$$name.json"; \
	done

licences:
	@tools/environment.sh supply
	@tools/environment.sh service
	@.venv/supply/bin/pip-licenses --python .venv/service/bin/python --format markdown --with-urls \
		--order license --ignore-packages pip setuptools > docs/licences.md.new
	@{ echo '<!-- Made by `make licences`; do not edit. -->'; echo '# Licences'; echo; \
		echo 'What the service is made of, in the versions of its lock.'; echo; \
		cat docs/licences.md.new; } > docs/licences.md && rm docs/licences.md.new

lint:
	@tools/environment.sh test --torch
	$(call step,ruff format,$(BIN)/ruff format --check --quiet . || { $(BIN)/ruff format --check .; false; })
	$(call step,ruff check,$(BIN)/ruff check .)
	$(call step,pyright,$(BIN)/pyright)
	$(call step,import-linter,$(BIN)/lint-imports --no-logo)

format:
	@tools/environment.sh test --torch
	$(BIN)/python -m tests.rollcast.write_sync_client
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

environments:
	@tools/environment.sh test --torch
	@tools/environment.sh service
	@tools/environment.sh service-test
	@tools/environment.sh protocol

# The lock of the tests holds every package but Ray; the others take their versions from it.
TEST_EXTRAS := simulation video dataframe service training test bench lint
UV_COMPILE = .venv/lock/bin/uv pip compile pyproject.toml --quiet --universal --python-version 3.11 \
	--generate-hashes --no-emit-package torch --annotation-style line --no-emit-index-url \
	--custom-compile-command 'make lock' $(if $(UPGRADE),--upgrade)

lock:
	@test -x .venv/lock/bin/uv || { $(or $(PYTHON),python3) -m venv .venv/lock; }
	@.venv/lock/bin/python -m pip install --quiet --disable-pip-version-check uv==$(UV_VERSION)
	$(UV_COMPILE) $(TEST_EXTRAS:%=--extra %) --output-file requirements/test.txt
	$(UV_COMPILE) --extra service --constraint requirements/test.txt \
		--output-file requirements/service.txt
	$(UV_COMPILE) --extra service --extra test --constraint requirements/test.txt \
		--output-file requirements/service-test.txt
	$(UV_COMPILE) --extra training --constraint requirements/test.txt \
		--output-file requirements/training.txt
	$(UV_COMPILE) --extra ray --constraint requirements/test.txt \
		--output-file requirements/ray.txt
	$(UV_COMPILE) --extra ray --extra ray-training --extra test --extra bench --constraint requirements/test.txt \
		--output-file requirements/cluster.txt
	$(UV_COMPILE) --extra bench --constraint requirements/test.txt \
		--output-file requirements/bench.txt
	$(foreach name,fuzz mutation,$(UV_COMPILE) --extra $(name) --constraint requirements/test.txt \
		--output-file requirements/$(name).txt &&) true
	$(foreach name,protocol browser docs image supply $(PEERS),$(UV_COMPILE:pyproject.toml=) \
		--group pyproject.toml:$(name) --output-file requirements/$(name).txt &&) true

clean:
	rm -rf .venv .pytest_cache .ruff_cache .import_linter_cache .hypothesis build dist docs/generated *.egg-info
	find . -path ./.git -prune -o -type d -name __pycache__ -exec rm -rf {} +
