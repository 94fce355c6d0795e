# SPDX-License-Identifier: Apache-2.0
# `make` alone prints what there is to make. T=word narrows any test, V=1 shows commands and whole outputs.

B ?= build
UNITY_DIR ?= build/unity
T ?=
V ?= 0
export T V

MAKEFLAGS += --no-builtin-rules
.DELETE_ON_ERROR:
.SECONDARY:
.DEFAULT_GOAL := help
Q := $(if $(filter 1,$(V)),,@)
say = $(if $(filter 1,$(V)),,@echo '  $(1)';)

PY := .venv/bin/python
VERSION := $(shell sed -n 's/^version = "\(.*\)"/\1/p' host/inertiad/pyproject.toml)
SITE := .venv/site
GEN := $(patsubst lcm_types/%.lcm,build/gen/inertiad_lcm_%.c,$(wildcard lcm_types/*.lcm))

CORE := $(patsubst %.c,$(B)/obj/%.o,$(wildcard firmware/core/*.c))
IO := $(patsubst %.c,$(B)/obj/%.o,$(wildcard firmware/io/*.c) $(GEN))
LIBS = $(B)/lib/libinertiad_io.a $(B)/lib/libinertiad_core.a $(SITE)/lib/liblcm.a -l:libglib-2.0.so.0 -pthread -lm
APP := $(patsubst %.c,$(B)/obj/%.o,$(wildcard firmware/app/*.c))
PROGRAMS := $(B)/bin/inertiad $(B)/bin/inertiactl
EXAMPLES := $(patsubst host/eigen/examples/%.cpp,$(B)/bin/examples/%,$(wildcard host/eigen/examples/*.cpp))
BINDING := $(patsubst host/eigen/python/%.cpp,$(B)/python/%.so,$(wildcard host/eigen/python/*.cpp))
UNIT := $(patsubst test/%.c,$(B)/test/%,$(wildcard test/unit/test_*.c test/laws/test_*.c))
FUZZ := $(patsubst test/%.c,$(B)/test/%,$(wildcard test/fuzz/fuzz_*.c))
BENCH := $(addprefix $(B)/,$(basename $(wildcard test/bench/*.c test/bench/*.cpp)))
ACCEPT := $(addprefix $(B)/,$(basename $(wildcard test/accept/*.c test/accept/*.cpp)))

# No -ffast-math and no contraction: the same log gives the same bytes on every machine.
OPT ?= -O2 -g
# Checked by test/host/test_hardening.py. Not under sanitizers, which check more and which _FORTIFY_SOURCE would blind.
BRANCHES := $(firstword $(foreach f,-fcf-protection=full -mbranch-protection=standard,$(shell $(CC) $(f) -x c -E /dev/null -o /dev/null 2>/dev/null && echo $(f))))
HARDENING = $(if $(SANITIZE),,-fstack-protector-strong -U_FORTIFY_SOURCE -D_FORTIFY_SOURCE=2 $(BRANCHES))
LDFLAGS = -Wl,-z,relro,-z,now,-z,noexecstack
FLAGS = $(OPT) $(SANITIZE) $(HARDENING) -fPIC -fno-math-errno -ffp-contract=off -fstack-usage -Wall -Wextra -Wconversion \
    $(WERROR) -MD -MP
INCLUDE := -Ifirmware/core -Ifirmware/io -isystem build/gen -isystem $(SITE)/include
CFLAGS = -std=gnu11 $(FLAGS) -Wshadow -Wstrict-prototypes -Wmissing-prototypes $(INCLUDE)
CXXFLAGS = -std=c++17 $(FLAGS) $(INCLUDE) -Ihost/eigen/include -isystem /usr/include/eigen3
$(CORE): CFLAGS += -std=c11
$(B)/obj/firmware/app/options.o: CFLAGS += -DINERTIAD_VERSION='"$(VERSION)"'
$(B)/obj/firmware/app/options.o: host/inertiad/pyproject.toml

## Print this list
help:
	@awk '/^## /{d=substr($$0,4); next} /^[a-z0-9-]+:/{if(d){t=$$1; sub(":.*","",t); printf "  make %-14s %s\n",t,d}} {d=""}' $(filter-out %.d,$(MAKEFILE_LIST))
	@echo '  T=word narrows a test, V=1 shows commands'

# ---- set-up: each stamp is one group of packages ------------------------------------------------------------------

## Install what building, running and testing need: system packages, .venv
setup: .venv/run.stamp .venv/test.stamp $(UNITY_DIR)/unity.c

.venv/%.stamp: host/inertiad/pyproject.toml tools/setup
	$(Q)tools/setup $*
	@touch $@
.venv/test.stamp .venv/lint.stamp .venv/accept.stamp .venv/docs.stamp .venv/dist.stamp .venv/m7.stamp \
    .venv/coverage.stamp .venv/fuzz.stamp: .venv/run.stamp

build/unity/unity.c:
	$(call say,fetch Unity)tools/unity $(@D)

# ---- build --------------------------------------------------------------------------------------------------------

## Build daemon, inertiactl, Python binding and C++ examples into build/
build: $(PROGRAMS) $(BINDING) $(EXAMPLES) build/python/inertiad_lcm

$(GEN) &: $(wildcard lcm_types/*.lcm) | .venv/run.stamp
	$(call say,generate lcm_types)rm -rf build/gen build/python/inertiad_lcm && mkdir -p build/gen build/python && \
	    $(SITE)/bin/lcm-gen -c --c-cpath build/gen --c-hpath build/gen -p --ppath build/python lcm_types/*.lcm
build/python/inertiad_lcm: | $(GEN)

$(B)/obj/%.o: %.c | $(GEN)
	@mkdir -p $(@D)
	$(call say,cc  $<)$(CC) $(CFLAGS) -c $< -o $@
$(B)/obj/build/gen/%.o: build/gen/%.c
	@mkdir -p $(@D)
	$(Q)$(CC) $(CFLAGS) -w -c $< -o $@
$(B)/obj/%.o: %.cpp | $(GEN)
	@mkdir -p $(@D)
	$(call say,c++ $<)$(CXX) $(CXXFLAGS) -c $< -o $@

$(B)/lib/libinertiad_core.a: $(CORE)
$(B)/lib/libinertiad_io.a: $(IO)
$(B)/lib/%.a:
	@mkdir -p $(@D)
	$(Q)rm -f $@ && $(AR) rcs $@ $^

$(B)/bin/inertiactl: tools/inertiactl
	@mkdir -p $(@D)
	$(Q)install -m 755 $< $@
$(B)/bin/inertiad: $(APP) $(B)/lib/libinertiad_io.a $(B)/lib/libinertiad_core.a
	@mkdir -p $(@D)
	$(call say,ld  $@)$(CC) -pie $(LDFLAGS) $(SANITIZE) $(APP) $(LIBS) -o $@
$(B)/bin/examples/%: $(B)/obj/host/eigen/examples/%.o $(B)/lib/libinertiad_io.a $(B)/lib/libinertiad_core.a
	@mkdir -p $(@D)
	$(call say,ld  $@)$(CXX) $(SANITIZE) $< $(LIBS) -o $@

NANOBIND := $(SITE)/nanobind
PYTHON_H = $(shell $(PY) -c 'import sysconfig; print(sysconfig.get_path("include"))')
BINDING_FLAGS = -fvisibility=hidden -fno-strict-aliasing -DNB_COMPACT_ASSERTIONS \
    -isystem $(NANOBIND)/include -isystem $(NANOBIND)/ext/robin_map/include -isystem $(PYTHON_H)
$(B)/obj/host/eigen/python/%.o: CXXFLAGS += $(BINDING_FLAGS)
$(B)/obj/nanobind.o: | .venv/run.stamp
	@mkdir -p $(@D)
	$(call say,c++ nanobind)$(CXX) $(CXXFLAGS) $(BINDING_FLAGS) -w -c $(NANOBIND)/src/nb_combined.cpp -o $@
$(B)/python/inertiad_core.so: $(patsubst %.cpp,$(B)/obj/%.o,$(wildcard host/eigen/python/core/*.cpp))
$(B)/python/%.so: $(B)/obj/host/eigen/python/%.o $(B)/obj/nanobind.o $(B)/lib/libinertiad_io.a $(B)/lib/libinertiad_core.a
	@mkdir -p $(@D)
	$(call say,ld  $@)$(CXX) -shared $(LDFLAGS) $(filter %.o,$^) $(LIBS) -Wl,--exclude-libs,ALL -o $@

## Simulate the paper's experiment, stream it through the daemon, compare with the truth
demo: build
	$(Q)$(B)/bin/inertiactl demo -o build/demo

## Build the documentation as a site in build/docs/; runs the commands of its pages (about 2 min)
docs: .venv/docs.stamp build
	$(Q)$(PY) host/docs/build.py

# ---- packages, microcontroller -----------------------------------------------------------------------------------

include tools/install.mk
include firmware/ports/m7.mk
include tools/fmu.mk

# ---- tests: tools/test runs the tiers, counts, and fails when one fails, crashes or is empty --------------------------

TESTED := build unit-programs accept-programs fmu
PARALLEL = $(if $(findstring jobserver,$(MAKEFLAGS)),,-j$(shell nproc))

## Run the tiers unit, laws, host, vcan and asan; ends with one line: N passed, N failed, N skipped
test: .venv/test.stamp .venv/docs.stamp
	@$(MAKE) --no-print-directory $(PARALLEL) $(TESTED) micro vcan-runs asan-programs
	@$(PY) tools/test unit laws host vcan asan

## Run the quick tests: unit, laws, and those of the host that are not marked slow
test-quick: .venv/test.stamp .venv/docs.stamp
	@$(MAKE) --no-print-directory $(PARALLEL) $(TESTED)
	@$(PY) tools/test --quick unit laws host

## Test the stages of the core (Unity)
test-unit: unit-programs micro
	@$(PY) tools/test unit

## Build the core for microcontrollers: 8 cables, short buffers, state under 64 KiB
micro:
	@$(MAKE) --no-print-directory B=build/micro OPT='-O2 -DIPE_PROFILE_MICRO' WERROR=-Werror build/micro/lib/libinertiad_core.a

## Test the laws the mathematics must keep
test-laws: .venv/test.stamp build unit-programs
	@$(PY) tools/test laws

## Test the Python package, the C++ layer and the programs end to end (pytest)
test-host: .venv/test.stamp .venv/docs.stamp build accept-programs fmu
	@$(PY) tools/test host

## Test the daemon on vcan, on two emulated controllers and on a serial adapter, in a guest kernel
test-vcan: .venv/test.stamp vcan-runs
	@$(PY) tools/test vcan

## Test the service under systemd in a guest: commands and positions of this host, watchdog, stop
test-systemd: .venv/test.stamp vcan-runs
	@$(PY) tools/test systemd

## Run unit tests, laws and the fuzzers' corpora under the address and undefined-behaviour sanitizers
test-asan: asan-programs
	@$(PY) tools/test asan

## Measure which lines of the core its unit tests and laws run; fails below 95 % of lines or 90 % of branches (page: build/coverage/index.html)
coverage: .venv/coverage.stamp $(UNITY_DIR)/unity.c | $(GEN)
	@$(MAKE) --no-print-directory B=build/coverage OPT='-O0 -g' SANITIZE=--coverage unit-programs
	$(Q)find build/coverage -name '*.gcda' -delete
	$(Q)for t in build/coverage/test/*/test_*; do [ ! -x $$t ] || $$t >$$t.txt || { cat $$t.txt; exit 1; }; done
	$(Q)$(PY) -m gcovr --filter firmware/core/ --object-directory build/coverage --print-summary --fail-under-line 95 --fail-under-branch 90 \
	    --html-details build/coverage/index.html --sort uncovered-percent build/coverage

unit-programs: $(UNIT)
fuzz-programs: $(FUZZ)
SANITIZERS := -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -fno-omit-frame-pointer
asan-programs: $(UNITY_DIR)/unity.c | $(GEN)
	@$(MAKE) --no-print-directory B=build/asan OPT='-O1 -g' SANITIZE='$(SANITIZERS)' unit-programs fuzz-programs

SECONDS ?= 120
FUZZERS := $(patsubst test/fuzz/fuzz_%.c,%,$(wildcard test/fuzz/fuzz_*.c))
## Feed the readers and the pipeline what libFuzzer makes up (T=candump, SECONDS=600); what it finds is left in build/fuzz/
fuzz: .venv/fuzz.stamp $(UNITY_DIR)/unity.c | $(GEN)
	@$(MAKE) --no-print-directory B=build/fuzz CC=clang OPT='-O2 -g' SANITIZE='$(SANITIZERS) -fsanitize=fuzzer-no-link' \
	    LIBFUZZER=-fsanitize=fuzzer fuzz-programs
	$(Q)tools/fuzz $(SECONDS) $(or $(T),$(FUZZERS))

vcan-runs: build
	$(Q)$(PY) test/vcan/prepare.py

TEST_CFLAGS := -Wno-missing-prototypes -DUNITY_INCLUDE_DOUBLE -isystem $(UNITY_DIR) -Itest/unit -Itest/fuzz
$(B)/obj/test/%.o: CFLAGS += $(TEST_CFLAGS)
$(UNIT:$(B)/test/%=$(B)/obj/test/%.o): | $(UNITY_DIR)/unity.c
$(B)/obj/unity.o: $(UNITY_DIR)/unity.c
	@mkdir -p $(@D)
	$(Q)$(CC) $(CFLAGS) $(TEST_CFLAGS) -w -c $< -o $@
$(UNIT) $(FUZZ): $(B)/obj/unity.o
$(FUZZ:$(B)/test/%=$(B)/obj/test/%.o): | $(UNITY_DIR)/unity.c
$(FUZZ): $(if $(LIBFUZZER),,$(B)/obj/test/fuzz/replay.o)
$(B)/test/%: $(B)/obj/test/%.o $(B)/lib/libinertiad_io.a $(B)/lib/libinertiad_core.a
	@mkdir -p $(@D)
	$(call say,ld  $@)$(CC) $(SANITIZE) $(LIBFUZZER) $(filter %.o,$^) $(LIBS) -o $@

$(BENCH) $(ACCEPT): $(B)/test/%: $(B)/obj/test/%.o $(B)/lib/libinertiad_io.a $(B)/lib/libinertiad_core.a
	@mkdir -p $(@D)
	$(call say,ld  $@)$(CXX) $(SANITIZE) $< $(LIBS) -o $@

BENCHES := core offline simulate control gaps excite report record pacing receive soak

## Measure beside other software (40 min; T="core receive" picks of: core offline simulate control gaps excite report record pacing receive soak)
bench: $(addprefix bench-,$(or $(T),$(BENCHES)))
$(addprefix bench-,$(BENCHES)): .venv/test.stamp build bench-programs
bench-programs: $(BENCH)
bench-core bench-offline bench-simulate bench-control bench-gaps bench-excite bench-report bench-record: bench-%:
	$(Q)$(PY) test/bench/$*.py
bench-pacing:
	$(Q)tools/vcan $(PY) test/bench/pacing.py
$(B)/bench/can_over_udp.so: test/host/can_over_udp.c
	@mkdir -p $(@D)
	$(Q)$(CC) $(CFLAGS) -Wno-missing-prototypes -shared $< -o $@
bench-receive: $(B)/bench/can_over_udp.so
	$(Q)$(PY) test/bench/flood.py
	$(Q)$(PY) -S test/bench/receive.py --over-udp
	$(Q)tools/vcan python3 -S test/bench/receive.py
bench-soak:
	$(Q)$(PY) test/bench/flood.py
	$(Q)$(PY) test/bench/soak.py

## Judge the acceptance list on unseen seeds: limit, measured, PASS or FAIL; pictures in build/accept/ (T="T6 T8")
accept: .venv/test.stamp .venv/accept.stamp build accept-programs second-target
	$(Q)$(PY) test/accept/accept.py $(T)

accept-programs: $(ACCEPT)

# The same sources for another processor; an emulator runs it. Nothing of liblcm is needed: what is not used is dropped.
second-target: .venv/accept.stamp $(GEN)
	@$(MAKE) --no-print-directory B=build/aarch64 CC=aarch64-linux-gnu-gcc AR=aarch64-linux-gnu-ar \
	    OPT='-O2 -ffunction-sections' build/aarch64/replay
build/aarch64/replay: $(addprefix build/aarch64/,obj/test/accept/replay.o lib/libinertiad_io.a lib/libinertiad_core.a)
	$(call say,ld  $@)$(CC) -static -Wl,--gc-sections $^ -lm -o $@

# Without the two that read with liblcm, which is built for this machine only.
AARCH64_UNIT := $(filter-out build/aarch64/test/unit/test_publish build/aarch64/test/unit/test_record, \
    $(patsubst test/%.c,build/aarch64/test/%,$(wildcard test/unit/test_*.c)))
## Run the unit tests, and logs beside this machine's bits, for aarch64 under qemu-user
aarch64: .venv/test.stamp .venv/accept.stamp build accept-programs second-target $(UNITY_DIR)/unity.c
	@$(MAKE) --no-print-directory B=build/aarch64 CC=aarch64-linux-gnu-gcc AR=aarch64-linux-gnu-ar \
	    OPT='-O2 -ffunction-sections' LIBS='$(addprefix build/aarch64/lib/libinertiad_,io.a core.a) -static -Wl,--gc-sections \
	    -pthread -lm' $(AARCH64_UNIT)
	$(Q)$(PY) tools/test aarch64

## Measure the error of `inertiactl sync` against known delays, on unseen seeds (about 20 min)
accept-sync: .venv/test.stamp build
	$(Q)$(PY) test/accept/sync.py

SEEDS ?= $(or $(SEED),1)
## Judge both programs by an independent simulation of real set-ups (under 15 min; T="=pushed", SEEDS=1-5, JOBS=2)
strangers: .venv/test.stamp build $(B)/stranger/native.so
	$(Q)$(PY) test/stranger/stranger.py $(T) --seeds $(SEEDS) --jobs $(or $(JOBS),2)
$(B)/stranger/native.so: $(wildcard test/stranger/*.c)
	@mkdir -p $(@D)
	$(call say,cc  $@)$(CC) -std=gnu11 -O2 -ffp-contract=off -fPIC -Wall -Wextra -Wconversion -shared $^ -lm -o $@

## Rewrite the type stubs of the Python bindings from what they export
stubs: build
	$(Q)$(PY) tools/stubs.py

# ---- habits ---------------------------------------------------------------------------------------------------------

C_FILES = $(shell find firmware host test -name '*.[ch]' -o -name '*.[ch]pp')
PY_FILES = host test tools/test tools/readme $(wildcard tools/*.py)

## Rewrite C, C++ and Python sources in the project's format
format: .venv/lint.stamp
	$(Q).venv/bin/clang-format -i $(C_FILES)
	$(Q).venv/bin/ruff format -q --config host/inertiad/pyproject.toml $(PY_FILES)

## Tell which files `make format` would change
format-check: .venv/lint.stamp
	$(Q).venv/bin/clang-format --dry-run --Werror $(C_FILES)
	$(Q).venv/bin/ruff format -q --check --config host/inertiad/pyproject.toml $(PY_FILES)

# GCC 12's analyzer follows no loop that fills an array, so that each array of the core is uninitialised to it; the other
# compilers' warnings and the sanitizers look for those.
ANALYZER := -fanalyzer -Wno-analyzer-use-of-uninitialized-value

## Look for mistakes without running: compiler warnings, GCC's analyzer, clang-tidy, ruff, mypy, shellcheck
lint: .venv/lint.stamp .venv/test.stamp build
	@$(MAKE) --no-print-directory B=build/strict WERROR=-Werror build unit-programs
	@$(MAKE) --no-print-directory B=build/analyzer OPT='-O2 $(ANALYZER)' WERROR=-Werror build/analyzer/bin/inertiad
	$(Q).venv/bin/clang-tidy --quiet $(wildcard firmware/*/*.c) -- -std=gnu11 -DINERTIAD_VERSION='"$(VERSION)"' $(INCLUDE)
	$(Q).venv/bin/ruff check -q --config host/inertiad/pyproject.toml $(PY_FILES)
	$(Q).venv/bin/mypy --config-file host/inertiad/pyproject.toml host/inertiad/inertiad
	$(Q)shellcheck -x tools/setup tools/unity tools/sysroot tools/vcan tools/fuzz tools/inertiactl tools/mistakes .ci/run

## Run what a change must pass: format-check, lint, test
check: format-check lint test

## Print bytes per stage of the core, and its deepest stack frames
size: $(B)/lib/libinertiad_core.a
	@size $<
	@echo; echo 'bytes of stack, largest frames:'
	@cat $(CORE:.o=.su) | sort -k 2 -n -r | awk '{sub(".*/","",$$1); printf "%7d  %s\n",$$2,$$1}' | head -5

## Remove build/ (make clean-all: .venv/ as well)
clean:
	rm -rf build
clean-all: clean
	rm -rf .venv

.PHONY: help setup build demo accept test test-unit test-laws test-host test-vcan test-asan unit-programs asan-programs accept-sync strangers accept-programs second-target vcan-runs bench $(addprefix bench-,$(BENCHES)) format format-check lint check size clean clean-all stubs test-quick micro docs coverage fuzz fuzz-programs aarch64 test-systemd
-include $(shell find $(B)/obj -name '*.d' 2>/dev/null)
