# SPDX-License-Identifier: Apache-2.0
# The feed-forward's model for FMI 3.0. Header files: fmpy's. Nothing of liblcm: the configuration's types are generated
# without it, and the C++ library is linked in, so that other tools can load the model.

FMI_H = $(SITE)/fmpy/c-code
FMU_GEN := build/fmu/gen/stamp
FMU_PY := host/inertiad/inertiad/exchange/fmu.py
FMU_TOKEN = $(or $(shell sed -n 's/^TOKEN.*= "\(.*\)".*/\1/p' $(FMU_PY)),$(error $(FMU_PY) has no TOKEN))

.PHONY: fmu
## Build the model that `inertiactl export --to fmu` packs: build/lib/inertiad_feed_forward.so
fmu: build/lib/inertiad_feed_forward.so

.venv/fmu.stamp: .venv/run.stamp

$(FMU_GEN): $(wildcard lcm_types/*_config_t.lcm) | .venv/run.stamp
	@rm -rf $(@D) && mkdir -p $(@D)
	$(Q)$(SITE)/bin/lcm-gen -c --c-no-pubsub --c-cpath $(@D) --c-hpath $(@D) $^ && \
	    cd $(@D) && $(CC) $(CFLAGS:-I%=-I$(CURDIR)/%) -w -I. -isystem $(CURDIR)/$(SITE)/include -c *.c && touch stamp

build/lib/inertiad_feed_forward.so: host/fmi/feed_forward.cpp $(FMU_PY) $(FMU_GEN) $(B)/lib/libinertiad_core.a \
    $(B)/obj/firmware/io/config_file.o $(B)/obj/firmware/io/crc.o $(wildcard host/eigen/include/inertiad/*.hpp) | .venv/fmu.stamp
	@mkdir -p $(@D)
	$(call say,c++ $<)$(CXX) $(CXXFLAGS) -fvisibility=hidden -DINERTIAD_FMU_TOKEN='"$(FMU_TOKEN)"' -isystem $(FMI_H) \
	    -shared -s $(LDFLAGS) -Wl,-z,defs -static-libstdc++ -static-libgcc $< $(dir $(FMU_GEN))*.o \
	    $(B)/obj/firmware/io/config_file.o $(B)/obj/firmware/io/crc.o $(B)/lib/libinertiad_core.a -lm -o $@ \
	    -Wl,--exclude-libs,ALL
