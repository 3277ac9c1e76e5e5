# SPDX-License-Identifier: Apache-2.0
# Everything begins here: `make help`.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
LINT_STAMP := $(VENV)/.installed-lint
SOURCES := pyproject.toml setup.py release/message_classes.py cm/client/aio/operations.py cm/client/aio/lease.py cm/schema/data/runtime.schema.json release/backend.py cm/wire/cm.proto $(wildcard ros2/cm_interfaces/*/* csrc/*.c csrc/*.h csrc/build_cffi.py csrc/cffi/* kmod/uapi/*.h cm/simulation/rtl/harness/*.cpp cm/simulation/rtl/harness/*.h)
C_FILES := $(wildcard csrc/*.[ch] csrc/client/*.[ch] csrc/tests/*.[ch] kmod/uapi/*.h cm/simulation/rtl/harness/*.cpp cm/simulation/rtl/harness/*.h)
PYTEST ?= $(BIN)/python -m pytest
PYTEST_ARGS ?=
COMMA := ,
CORES := $(shell nproc)
JOBS ?= $(shell echo $$((2 * $(CORES))))
# The suites for which README's packages do not suffice: their tests have a marker, which `make test` leaves out.
FURTHER := design networks web programs release soak
SUITES ?= tests/unit tests/fuzz tests/release tests/integration tests/device tests/soak tests/vm
OUT ?= demo
IMAGES ?=
COUNT ?= 100
SEED ?= 1
MINUTES ?= 10
PLACEMENTS ?= 0
ROUNDS ?= 8
STOPPED ?= 4

.DEFAULT_GOAL := help
.PHONY: help setup docs demo demo-open demo-scrub demo-ros demo-fleet device-suite test test-bare test-lowest $(FURTHER:%=test-%) test-c test-node test-go test-rtl test-open test-bench test-ros test-fleet test-images test-vm vm soak soak-fleet fuzz mutation bench bench-compare lint format wheel deb board-bundle release-check layer clean

help: ## the targets that most people need, then the others
	@awk -F':[^#]*## ' '/^[a-z-]+:[^#]*## /{printf "  %-13s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@awk -F':[^#]*### ' 'BEGIN{print ""} /^[a-z-]+:[^#]*### /{printf "  %-13s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

CHECK_SYSTEM = ./.ci/check-system "$(PYTHON)" "$(VENV)"

define install
	@echo "setting up $(VENV) with $(1)"
	@.ci/pip-install $(VENV) $(2)
endef

$(BIN)/python:
	@$(CHECK_SYSTEM)
	@$(PYTHON) -m venv $(VENV)

$(STAMP): $(SOURCES) | $(BIN)/python
	$(call install,the package and what the demonstration needs (once; half a minute),--editable '.[demo]')
	@touch $@

# What a suite needs beyond that: once, and without a network from then on. The package itself is not built again.
$(VENV)/.installed-%: $(STAMP)
	$(call install,what $* needs (once),'fpga-cm[$*]')
	@touch $@

# Suites that need what others bring together.
$(VENV)/.installed-test-soak: $(VENV)/.installed-test $(VENV)/.installed-test-networks
$(VENV)/.installed-test-release: $(VENV)/.installed-test $(LINT_STAMP) $(VENV)/.installed-release
$(VENV)/.installed-test-soak $(VENV)/.installed-test-release:
	@touch $@

$(VENV)/.installed-demo-ros: $(STAMP)
	$(call install,what the demonstration for ROS 2 needs (once),'fpga-cm[zenoh$(COMMA)demo]' 'zenoh-ros2-sdk>=0.1.8')
	@touch $@

$(LINT_STAMP): $(STAMP)
	$(call install,what lint needs (once),'fpga-cm[lint$(COMMA)test$(COMMA)build$(COMMA)web$(COMMA)zenoh$(COMMA)record]')
	@$(BIN)/python -m grpc_tools.protoc -I. --pyi_out=. cm/wire/cm.proto
	@touch $@

setup: $(STAMP) ## a virtual environment with the package and what its demonstration needs (EXTRAS=web,build …: see docs/install.md)
	$(if $(EXTRAS),$(call install,$(EXTRAS),'fpga-cm[$(EXTRAS)]'))

demo: $(STAMP) ## the camera demonstration on a simulated board; writes demo/contact-sheet.png (IMAGES=DIR, OUT=DIR)
	@$(BIN)/cm demo --out $(OUT) $(if $(IMAGES),--images $(IMAGES))

demo-ros: $(VENV)/.installed-demo-ros ## a simulated board as a ROS 2 node, seen by rclpy where ROS 2 is sourced, elsewhere by zenoh_ros2_sdk (OUT=DIR)
	@$(BIN)/python ros2/demo.py --out $(if $(filter demo,$(OUT)),demo-ros,$(OUT))

test-ros: $(STAMP) ### cm_ros2 against a real ROS 2: ROS=FOLDER with its setup.bash, or Jazzy's wheels from PyPI (x86-64; needs cmake, g++)
	@ros2/test.sh $(abspath $(BIN))/python $(ROS)

demo-open: $(VENV)/.installed-build ## Verilog to partial bitstreams without a vendor's tool, and the modules run from their bits (OUT=DIR; fetches some 50 MB; needs verilator)
	@$(BIN)/cm build tools --fetch
	@mkdir -p $(OUT) && cp -r cm/data/examples/camera cm/data/examples/open_camera $(OUT)/
	@$(BIN)/cm build generate $(OUT)/open_camera/build.yaml
	@$(BIN)/cm build run --flow open -j$(JOBS) $(OUT)/open_camera/build.yaml
	@$(BIN)/cm build collect --schema $(OUT)/open_camera/build.yaml --target $(OUT)/open_camera/target
	@$(BIN)/python examples/open_camera.py $(OUT)/open_camera/build.yaml

demo-scrub: $(VENV)/.installed-build ### a bit of a running module's configuration turns over, the picture goes wrong and comes back (OUT=DIR; as demo-open, which it builds)
	@$(MAKE) --no-print-directory demo-open OUT=$(OUT)
	@$(BIN)/cm demo --scrub $(OUT)/open_camera/build.yaml --out $(OUT)

# The slow files first, so that no worker is left with one at the end.
SHARE := loadfile --no-loadscope-reorder
RUN_TESTS = $(PYTEST) $(if $(STRICT),--no-skips) -n $(JOBS) --dist $(SHARE)
RUN_PLAIN = $(RUN_TESTS) $(SUITES) --board=sim --suite=plain $(PYTEST_ARGS)
test: $(VENV)/.installed-test test-c ## all tests that need no board and no further tools (SANITIZE=1: the C tests with sanitizers)
	$(RUN_PLAIN)
	@echo "What needs further tools: $(FURTHER:%=make test-%), make test-rtl test-open test-node test-go test-bench test-vm"

# Python 3.11 at most: numpy's oldest has no wheel for a newer one.
LOWEST := build/lowest
test-lowest: BIN := .venv/bin
test-lowest: ### `make test` of the last commit with the oldest version of each package that pyproject.toml allows (PYTHON=python3.11 or 3.10)
	@$(CHECK_SYSTEM)
	@rm -rf $(LOWEST) && git -c safe.directory='*' clone -q . $(LOWEST) && $(PYTHON) -m venv $(LOWEST)/.venv
	@.ci/pip-install $(LOWEST)/.venv uv
	@cd $(LOWEST) && .venv/bin/uv pip install --quiet --python .venv --resolution lowest-direct --editable '.[test]'
	cd $(LOWEST) && $(RUN_PLAIN)

test-design: ### the tests that read HDL, generate projects and run Tcl (apt: tcl device-tree-compiler)
test-networks: ### those of zenoh, ROS 2 and records (apt: python3-rosidl python3-empy)
test-web: ### those of the page (apt: chromium)
test-programs: ### those of C clients, shells, terminals, notebooks and type checkers (apt: the lines of .ci/run; some as root)
test-release: ### those of packages, wheels and the layer
test-soak: ### loads and attacks, in short (make soak: in long)
test-soak soak: SHARE := load --maxschedchunk=1  # few tests, each long and with a manager of its own
test-programs: $(LINT_STAMP)
$(FURTHER:%=test-%): test-%: $(VENV)/.installed-test-%
	$(RUN_TESTS) $(SUITES) --board=sim --suite=$* $(PYTEST_ARGS)

test-c:
	@$(CHECK_SYSTEM)
	@$(MAKE) --no-print-directory -s -j$(CORES) --output-sync -C csrc check $(if $(SANITIZE),SANITIZE=$(SANITIZE))

test-bare: ### README's commands on an empty root of Debian 12 and 13, as a plain user (root; mmdebstrap; BARE=trixie)
	tests/bare/run.sh $(BARE)

# NODE=18: with that version, which npm fetches, in place of the system's
OTHER_NODE := $(if $(NODE),PATH="$(abspath build/node$(NODE)/node_modules/node/bin):$$PATH";)
test-node: $(VENV)/.installed-test ### the client for Node.js: built, its tour over ipc and CURVE, and beside a manager that answers wrongly (npm fetches its packages)
	$(if $(NODE),npm install --prefix build/node$(NODE) --no-save --silent node@$(NODE))
	$(OTHER_NODE) node --version && cd clients/node && npm ci --ignore-scripts --silent && npm run --silent build && CM=cm PATH="$(abspath $(BIN)):$$PATH" npm test --silent
	$(OTHER_NODE) $(BIN)/cm conformance -- node clients/node/dist/test/driver.js
	$(OTHER_NODE) CM_DRIVER="node clients/node/dist/test/driver.js" $(PYTEST) tests/fuzz/test_wrong_answers.py -q -k a_client_lives

# Debian's packages of Go are a GOPATH, so that no module is fetched.
GO := GO111MODULE=off GOPATH="$(abspath build/go):/usr/share/gocode" go
test-go: $(VENV)/.installed-test ### the client in Go: built, its tour over ipc and TCP, and beside a manager that answers wrongly (apt: golang-go golang-google-protobuf-dev protoc-gen-go-1-5 protobuf-compiler)
	mkdir -p build/go/src && ln -sfn ../../../clients/go build/go/src/fpga-cm
	$(GO) generate fpga-cm && cd clients/go && test -z "$$(gofmt -l *.go driver)"
	$(GO) vet fpga-cm fpga-cm/driver && $(GO) build -o build/go/driver fpga-cm/driver
	CM=cm PATH="$(abspath $(BIN)):$$PATH" $(GO) test -race -timeout 10m fpga-cm
	$(BIN)/cm conformance -- build/go/driver
	CM_DRIVER=build/go/driver $(PYTEST) tests/fuzz/test_wrong_answers.py -q -k a_client_lives

test-open: $(VENV)/.installed-test-rtl ### modules by their bits, and the flow of open tools (nextpnr and Project X-Ray are fetched from Debian)
	$(RUN_TESTS) tests/open $(PYTEST_ARGS)
	$(RUN_TESTS) tests/unit --suite=open $(PYTEST_ARGS)

test-rtl: $(VENV)/.installed-test-rtl ### the HDL and what is generated from it, on Verilator or Icarus with cocotb
	$(PYTEST) tests/rtl $(PYTEST_ARGS)
	$(PYTEST) tests/device --board=rtl $(PYTEST_ARGS)
	$(BIN)/cm demo --rtl --out build/demo-rtl

test-images: $(VENV)/.installed-test-design ### overlays on trees of stock images, made of Debian's kernel source, which is fetched (apt: device-tree-compiler cpp; LINUX=DIR: an unpacked one)
	$(PYTEST) tests/images $(PYTEST_ARGS)

test-vm: $(VENV)/.installed-test-design ### kernel modules and the whole manager on a board in QEMU
	@$(MAKE) --no-print-directory -C tests/vm test PYTHON="$(abspath $(BIN)/python)" TIERS="$(TIERS)" REQUIRED=$(REQUIRED)

demo-fleet: $(VENV)/.installed-zenoh ## three simulated boards over zenoh: one observes, another decides, the third acts; one is killed and comes back (OUT=DIR, STORE=etcd)
	@$(if $(filter etcd,$(STORE)),$(ETCD))
	@$(BIN)/cm demo --fleet $(if $(STORE),--store $(STORE)) --out $(if $(filter demo,$(OUT)),demo-fleet,$(OUT))

# Its package starts a member of its own, which nobody needs.
ETCD = command -v etcd >/dev/null || apt-get install -qq -y --no-install-recommends etcd-server etcd-client >/dev/null

test-fleet: $(VENV)/.installed-test-networks ### a fleet over the keeper, and over three members of etcd: ROUNDS=8 changes each, in which something is killed, stopped, cut off, late, lost or full (apt: etcd-server, as root; STOPPED=4 seconds, SEED=1)
	@$(ETCD)
	CM_ETCD=1 $(PYTEST) tests/fleet tests/integration/test_fleet_findings.py -s --fleet-rounds=$(ROUNDS) --stopped=$(STOPPED) --seed=$(SEED) $(PYTEST_ARGS)

soak-fleet: ### the same in long: each phase of a change meets each fault, over both stores (SEED=1; two hours)
	$(MAKE) --no-print-directory test-fleet ROUNDS=500

device-suite: $(VENV)/.installed-test ## tests of the device layer: BOARD=sim, or BOARD=hw TARGET=user@host (or LAB=labgrid.yaml; BOARD_FILE, BOARD_PYTHON)
ifeq ($(BOARD),hw)
	$(BIN)/python tests/device/over_ssh.py $(if $(LAB),--lab $(LAB),--target $(or $(TARGET),$(error device-suite: say TARGET=user@host or LAB=file))) \
		$(if $(BOARD_FILE),--board-file $(BOARD_FILE)) $(if $(BOARD_PYTHON),--python $(BOARD_PYTHON)) --sudo $(PYTEST_ARGS)
else
	$(PYTEST) tests/device --board=sim $(PYTEST_ARGS)
endif

vm: $(VENV)/.installed-build ## a shell on that board, with a manager running and its ports forwarded
	@$(MAKE) --no-print-directory -C tests/vm vm PYTHON="$(abspath $(BIN)/python)" TIERS="$(TIERS)"

soak: $(VENV)/.installed-fuzz $(FURTHER:%=$(VENV)/.installed-test-%) ### what strangers tried, ten thousand changes of mode, ten thousand upsets, scraped ones too, a thousand in a page, each call that writes to the disk failed, five hundred rounds of replaced schemas, a minute of killed readers, every attack on limits, two regions and random designs by their bits (PLACEMENTS=N, default none), five thousand flipped bits, every virtual board; new examples for the tests that draw some
	$(RUN_TESTS) $(SUITES) --board=sim --suite=soak --kills=100 --rounds=20 --stress=30 $(PYTEST_ARGS)
	nice $(BIN)/python tests/fuzz/fuzz.py --minutes 0.1 --jobs $(JOBS)
	$(PYTEST) tests/unit tests/fuzz -m hypothesis --hypothesis-profile=search $(PYTEST_ARGS)
	$(PYTEST) tests/soak --changes=10000 --stress=60 --rounds=300 --kills=1000 --upsets=10000 --failing=0 --builds=500 $(PYTEST_ARGS)
	CM_SCHEDULES=20000 $(PYTEST) tests/unit/test_fleet_schedules.py -n $(CORES) $(PYTEST_ARGS)
	$(MAKE) --no-print-directory soak-fleet
	$(MAKE) --no-print-directory test-fleet ROUNDS=100 STOPPED=30
	CM_OPEN_7020=1 $(PYTEST) tests/open/test_open_regions.py tests/open/test_bits_modules.py $(PYTEST_ARGS)
	for device in xc7z010 xc7z020; do CM_PLACEMENTS=$(PLACEMENTS) CM_DEVICE=$$device CM_SEED=$(SEED) $(PYTEST) tests/open/test_open_placements.py $(PYTEST_ARGS) || exit 1; done
	for seed in 1 2 3 4 5; do CM_FLIPS=1000 CM_SEED=$$seed $(PYTEST) tests/open/test_bits_flips.py $(PYTEST_ARGS) || exit 1; done
	@$(MAKE) --no-print-directory test-vm TIERS=all

fuzz: $(VENV)/.installed-fuzz $(VENV)/.installed-test-networks ### ten minutes of search for bad input to every reader of bytes from outside (MINUTES=…, TARGETS=…, SEED=…)
	nice $(BIN)/python tests/fuzz/fuzz.py $(TARGETS) --minutes $(MINUTES) --jobs $(JOBS) $(if $(filter command,$(origin SEED)),--seed $(SEED))

mutation: $(VENV)/.installed-mutation $(VENV)/.installed-test-design ### whether the unit tests notice defects: 100 mutants of each package, with a fixed seed (COUNT=…, SEED=…, PACKAGES=…)
	nice $(BIN)/python tests/mutation/sample.py $(PACKAGES) --count $(COUNT) --seed $(SEED)

bench: $(VENV)/.installed-bench ## measure latency and throughput beside the alternatives
	$(BIN)/cm bench --json bench.json --plots bench-plots

test-bench: $(VENV)/.installed-test-bench ### every measurement in its quick form: that it runs, not how fast; and that no route has grown in counts (apt: strace)
	$(PYTEST) tests/bench $(PYTEST_ARGS)

# Another commit's tree, with an environment of its own; it stays for the next comparison.
BASE ?= $(shell cat tests/bench/BASE)
OTHER := build/bench-$(BASE)
bench-compare: $(VENV)/.installed-bench ### this tree beside another commit, in turns: BASE=COMMIT (default: that of tests/bench/BASE; QUICK=1; apt: strace valgrind)
	@git cat-file -e '$(BASE)^{commit}' || { echo "bench-compare: this clone does not have $(BASE): git fetch --unshallow"; exit 2; }
	@test -e $(OTHER)/.venv/.installed || { mkdir -p $(OTHER) && git archive '$(BASE)' | tar -x -C $(OTHER); }
	@test -e $(OTHER)/.venv/.installed || { $(PYTHON) -m venv $(OTHER)/.venv && cd $(OTHER) && \
		$(abspath .ci/pip-install) .venv --editable . && touch .venv/.installed; }
	$(BIN)/cm bench --compare $(OTHER) $(if $(QUICK),--quick)

lint: $(LINT_STAMP) ## ruff, ruff format, mypy (strict; the client for macOS and Windows too), clang-format, licences (reuse)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	@mkdir -p build
	$(BIN)/lint-imports --no-cache >build/lint-imports.log || { cat build/lint-imports.log; exit 1; }
	$(BIN)/python docs/rooms.py --check
	@for system in win32 darwin; do echo "$(BIN)/mypy --platform $$system"; \
		$(BIN)/mypy --config-file release/laptops.ini --platform $$system --cache-dir .mypy_cache/$$system || exit 1; done
	$(BIN)/clang-format --style=file:csrc/.clang-format --dry-run -Werror $(C_FILES)
	$(BIN)/reuse lint --quiet || { $(BIN)/reuse lint; exit 1; }

docs: $(VENV)/.installed-docs ## the site of docs/, into build/site, with no warning (apt: graphviz), after what is kept in pages: rooms, tables of keys and of states
	@for script in rooms schema_tables reconfiguration_tables request_tables; do $(BIN)/python docs/$$script.py || exit 1; done
	@docs/prose/check
	@$(BIN)/python docs/site.py $(SITE)

format: $(LINT_STAMP) ### format Python and C
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format --style=file:csrc/.clang-format -i $(C_FILES)

ARCHES ?= amd64 arm64 armhf
RELEASE := build/release
SDIST = $(RELEASE)/fpga_cm-$(shell sed -n 's/^__version__ = "\(.*\)"/\1/p' cm/_version.py).tar.gz
export SOURCE_DATE_EPOCH ?= $(shell git log -1 --format=%ct 2>/dev/null || echo 1577836800)

wheel: $(VENV)/.installed-release ### the archive of the sources, wheels for ARCHES (amd64 arm64 armhf) and one for any system, into build/release
	@mkdir -p $(RELEASE)
	@PYTHONPATH=release $(BIN)/python -c "import backend; backend.build_sdist('$(RELEASE)')" >$(RELEASE)/sdist.log 2>&1 || \
		{ cat $(RELEASE)/sdist.log; exit 1; }
	@rm -f $(RELEASE)/sdist.log
	@rm -f $(RELEASE)/*.whl
	@python3 release/wheels.py $(ARCHES:%=--arch %) --pure --out $(RELEASE) $(SDIST)

deb: wheel ## Debian packages for ARCHES, checked by lintian, into build/release
	@rm -f $(RELEASE)/*.deb
	@$(BIN)/python release/manpages.py $(RELEASE)/man
	@status=0; release/deb.sh $(SDIST) $(RELEASE) $(ARCHES) || status=$$?; \
		if [ $$status = 77 ]; then echo "SKIPPED: Debian packages (see above)"; exit 0; fi; exit $$status

board-bundle: wheel ## one archive with all that a board needs, and ./install in it: KERNEL=headers of its kernel, ARCHES=arm64 (or armhf; PYTHON_VERSION=3.10)
	@test -n "$(KERNEL)" || { echo "board-bundle: say KERNEL=DIR, the headers of the board's kernel (kmod/headers.sh fetches Debian's)"; exit 2; }
	@PYTHON=$(abspath $(BIN)/python) release/board_bundle.sh "$(KERNEL)" $(firstword $(ARCHES))

release-check: $(LINT_STAMP) $(VENV)/.installed-test-release ### changelog, versions, licences, links, the same bytes from two folders; writes the SBOM (TAG=v1.2.3)
	@$(BIN)/python release/check.py $(if $(TAG),--tag $(TAG))
	@$(PYTEST) -q tests/release/test_backend.py
	@mkdir -p $(RELEASE)
	@$(BIN)/python release/sbom.py $(RELEASE)/fpga-cm.cdx.json

layer: $(VENV)/.installed-release ### the sources into the Yocto layer, and the layer as an archive into build/release
	@release/layer.sh $(BIN)/python

clean: ## what was built, but not the environment
	rm -rf build bench-plots bench.json
	$(MAKE) -C csrc clean
	$(MAKE) -C dts clean
