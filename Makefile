# make serve   serve the committed models on http://127.0.0.1:8000 (PORT=9000 make serve)
# make test    format, lint, types, architecture and every test
#
# Both require Python 3.11 to 3.14 (PYTHON=/path/to/python3.11) and create their environments with
# tools/environment.sh, which installs uv with pip and the packages of uv.lock with uv. The exception
# is torch: pip installs it, because pip's own configuration or TORCH_INSTALL_ARGS leads to the CPU
# build, and uv would install the CUDA build of the lock (3 GB):
#
#   make test TORCH_INSTALL_ARGS='--index-url ADDRESS_OF_THE_CPU_BUILDS'

PORT ?= 8000

# Tests in these folders run where torch cannot be imported; all others run in .venv/test.
TORCH_FREE_TESTS := $(wildcard tests/service tests/contract)
# Clients and frameworks of other projects have an environment of their own.
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
# PyBullet in the environment of make serve. auto: where it has a wheel; yes: compiled if necessary.
SIMULATION ?= auto

# As in pyproject.toml; `make lock` writes its hashes into tools/uv.txt.
UV_VERSION := 0.13.9

export PYTHON
export TORCH_INSTALL_ARGS
# No step looks for newer releases or reports to anyone.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1
export ORT_DISABLE_TELEMETRY := 1
export RAY_USAGE_STATS_ENABLED := 0

BIN := .venv/test/bin
PYTEST_ARGS ?=
# Processes that run the tests side by side, a file at a time, in the order of tests/conftest.py.
PROCESSES ?= 2
SIDE_BY_SIDE = -m pytest -n $(PROCESSES) --dist loadfile --no-loadscope-reorder

# $(call step,NAME,COMMAND): one line before the command, and one that says which step failed.
define step
	@printf -- '--- %s\n' '$(1)'; $(2) || { printf 'rollcast: FAILED: %s\n' '$(1)' >&2; exit 1; }
endef

# $(call recorded,TARGET,COMMAND): a step whose end is recorded, and shown in docs/reliability.md.
recorded = $(call step,$(1),.venv/uv/bin/python tools/record.py $(1) $(2))

.PHONY: help serve training test wheels docs bench browser-test image-test cluster-test scaling lowest fuzz fuzz-api mutate faults soak sbom licences format lint environments lock clean
.NOTPARALLEL:

help:
	@echo 'make serve    serve the committed models on http://127.0.0.1:8000 (PORT=... picks another port)'
	@echo 'make training install what python -m training needs, in .venv/test'
	@echo 'make test     run every check and test'
	@echo 'make wheels   build the package and its models as wheels, into build/wheels'
	@echo 'make docs     build the documents into build/docs, check every link, execute the notebook'
	@echo 'make bench    measure the service and the bare loop, on an otherwise idle machine'
	@echo 'make browser-test  try the page in a real browser; needs Debian'"'"'s chromium'
	@echo 'make image-test  build the images and try them; needs root, debootstrap, buildah and podman'
	@echo 'make cluster-test  try the service on Ray: replicas and nodes are killed under load'
	@echo 'make scaling  measure the service on Ray, on an otherwise idle machine'
	@echo 'make lowest   the tests of client, service and video with the lowest supported versions'
	@echo 'make fuzz     random bytes into every input parser, millions of times; FUZZ_SHARE=0.01 for fewer'
	@echo 'make fuzz-api  valid and invalid requests from the OpenAPI description to every route of the real service'
	@echo 'make mutate   mutation tests of the core'
	@echo 'make faults   fault injection under load: killed processes, full disks, clock changes, stalled clients'
	@echo 'make soak     100,000 mixed requests and 5,000 simulations: memory, descriptors, times'
	@echo 'make sbom     software bills of materials of the images, as CycloneDX files in build/'
	@echo 'make licences the licences of the components, into docs/licences.md'
	@echo 'make format   format the code'
	@echo 'make lint     the checks of make test without its tests'
	@echo 'make lock     bring uv.lock up to pyproject.toml (UPGRADE=1: newest versions)'
	@echo 'make clean    remove environments and caches'

serve:
	@SIMULATION=$(SIMULATION) tools/environment.sh service
	@exec .venv/service/bin/python -m service --host 127.0.0.1 --port $(PORT)

training:
	@tools/environment.sh test
	@echo 'rollcast: .venv/test/bin/python -m training --help'

test: environments lint
	$(call step,tests,OMP_NUM_THREADS=1 $(BIN)/python $(SIDE_BY_SIDE) tests $(TORCH_FREE_TESTS:%=--ignore=%) $(PROTOCOL_TESTS:%=--ignore=%) $(IMAGE_TESTS:%=--ignore=%) $(CLUSTER_TESTS:%=--ignore=%) $(BROWSER_TESTS:%=--ignore=%) $(PYTEST_ARGS))
	$(call step,no torch in the service environment,! .venv/service/bin/python -c 'import torch' 2>/dev/null)
	$(call step,tests without torch,.venv/service-test/bin/python $(SIDE_BY_SIDE) $(or $(TORCH_FREE_TESTS),tests/service) $(PYTEST_ARGS))
	$(call step,clients of the protocol,.venv/peers/bin/python -m pytest $(PROTOCOL_TESTS) $(PYTEST_ARGS))
	@[ -x .venv/service-3.13/bin/python ] || echo 'rollcast: NOT TESTED: the service on Python 3.13, which is not installed' >&2
	@echo 'rollcast: every check and test passed'

wheels:
	@tools/environment.sh uv
	@tools/wheels.sh build/wheels
	@echo "rollcast: pip install --find-links build/wheels 'rollcast[serve]'"

docs:
	@tools/environment.sh service
	@tools/environment.sh tools
	$(call recorded,docs,tools/docs.sh)
	@echo 'rollcast: build/docs/index.html'

bench:
	@tools/environment.sh service
	@tools/environment.sh tools
	@tools/environment.sh peers
	$(call recorded,bench,.venv/tools/bin/python -m tests.bench.run $(BENCH_ARGS))

browser-test:
	@tools/environment.sh service
	@tools/environment.sh tools
	$(call recorded,browser-test,.venv/tools/bin/python -m pytest $(BROWSER_TESTS) $(PYTEST_ARGS))

image-test:
	@tools/environment.sh service
	@tools/environment.sh tools
	$(call recorded,image-test,.venv/tools/bin/python -m pytest $(IMAGE_TESTS) $(PYTEST_ARGS))

cluster-test:
	@tools/environment.sh service
	@tools/environment.sh test
	$(call recorded,cluster-test,env $(ON_RAY) $(BIN)/python -m pytest -W ignore $(CLUSTER_TESTS) $(PYTEST_ARGS))

scaling:
	@tools/environment.sh service
	@tools/environment.sh test
	@$(ON_RAY) $(BIN)/python -W ignore -m tests.cluster.scaling $(SCALING_ARGS)

lowest:
	@tools/environment.sh uv
	$(call recorded,lowest,tools/lowest.sh $(PYTEST_ARGS))

fuzz:
	@tools/environment.sh tools
	$(call recorded,fuzz,.venv/tools/bin/python -m tests.fuzz.run --share $(FUZZ_SHARE))

fuzz-api:
	@tools/environment.sh service
	@tools/environment.sh test
	$(call recorded,fuzz-api,$(BIN)/python -m tests.fuzz.api)

mutate:
	@tools/environment.sh tools
	$(call recorded,mutate,.venv/tools/bin/python -m tests.mutation.run $(MUTATE_ARGS))

faults:
	@tools/environment.sh service
	@tools/environment.sh tools
	$(call recorded,faults,.venv/tools/bin/python -m tests.faults.run $(FAULTS_ARGS))

soak:
	@tools/environment.sh service
	@tools/environment.sh tools
	$(call recorded,soak,.venv/tools/bin/python -m tests.soak.serve_long $(SOAK_ARGS))

SBOM_service := --extra service --extra simulation
SBOM_ray := --extra ray
SBOM_training := --extra training
sbom:
	@tools/environment.sh tools
	@mkdir -p build
	@for image in 'service $(SBOM_service)' 'ray $(SBOM_ray)' 'training $(SBOM_training)'; do \
		set -- $$image; name=$$1; shift; \
		.venv/uv/bin/uv export --frozen --quiet --no-emit-project --no-annotate --no-header "$$@" \
			| .venv/tools/bin/cyclonedx-py requirements - --pyproject pyproject.toml \
			--mc-type application --output-reproducible --sv 1.6 -o build/sbom-$$name.json || exit 1; \
		echo "rollcast: build/sbom-$$name.json"; \
	done

licences:
	@tools/environment.sh tools
	@tools/environment.sh service
	@.venv/tools/bin/pip-licenses --python .venv/service/bin/python --format markdown --with-urls \
		--order license --ignore-packages pip setuptools > docs/licences.md.new
	@{ echo '<!-- Made by `make licences`; do not edit. -->'; echo '# Licences'; echo; \
		echo 'What the service is made of, in the versions of its lock.'; echo; \
		cat docs/licences.md.new; } > docs/licences.md && rm docs/licences.md.new

lint:
	@tools/environment.sh test
	$(call step,ruff format,$(BIN)/ruff format --check --quiet . || { $(BIN)/ruff format --check .; false; })
	$(call step,ruff check,$(BIN)/ruff check .)
	$(call step,pyright,$(BIN)/pyright)
	$(call step,import-linter,$(BIN)/lint-imports --no-logo)

format:
	@tools/environment.sh test
	$(BIN)/python -m tests.rollcast.write_sync_client
	$(BIN)/python -m docs.page_guide
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

environments:
	@tools/environment.sh test
	@tools/environment.sh service
	@tools/environment.sh service-test
	@tools/environment.sh peers
	@tools/environment.sh service-3.13

# The lock contains addresses of the public index, whichever index this machine is configured with.
PUBLIC_INDEX := --default-index https://pypi.org/simple

lock:
	@tools/environment.sh uv
	@.venv/uv/bin/uv lock $(PUBLIC_INDEX) $(if $(UPGRADE),--upgrade)
	@{ echo '# uv itself, which installs all other packages. Written by `make lock`.'; \
		echo 'uv==$(UV_VERSION)' | .venv/uv/bin/uv pip compile - --no-config $(PUBLIC_INDEX) --quiet --universal \
			--python-version 3.11 --generate-hashes --no-emit-index-url --no-header --no-annotate; \
	} > .venv/uv.txt && mv .venv/uv.txt tools/uv.txt

clean:
	rm -rf .venv .pytest_cache .ruff_cache .import_linter_cache .hypothesis build dist docs/generated *.egg-info
	find . -path ./.git -prune -o -type d -name __pycache__ -exec rm -rf {} +
