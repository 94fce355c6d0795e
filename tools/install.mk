# SPDX-License-Identifier: Apache-2.0
# make release, make install, make dist. Release and dist build and ask the network; install only copies, as root or not.
# What is shipped is linked apart from build/bin: without debug information, which holds the path of the source tree, and
# against liblcm.so.1, so that this LGPL library can be replaced.

PREFIX ?= /usr/local
DESTDIR ?=
LIBDIR ?= $(PREFIX)/lib
SYSTEM_PYTHON ?= $(shell $(PY) -c 'import sys; print(sys._base_executable)')
SOVERSION := 0# of libinertiad.so and libinertiad_lcm.so: raised with every change of a public struct or function

R := $(B)/release
OBJCOPY ?= objcopy
PACKAGING := firmware/packaging
LCM = $(SITE)/lib/liblcm.so
SHIPPED = $(LDFLAGS) -Wl,-s,--build-id=none,--as-needed
HOST_SO := $(notdir $(BINDING))
# What of io/ the library holds: reading a compiled configuration, and lines of candump logs. Neither needs liblcm.
LIBRARY_IO := $(addprefix $(B)/obj/firmware/io/,config_file.o crc.o lines.o message.o candump.o)
LIBRARY_H := $(wildcard firmware/core/*.h) firmware/io/config_file.h firmware/io/candump.h

# The configuration's messages once more, without publish and subscribe and with local names.
$(R)/gen/stamp: $(wildcard lcm_types/*.lcm) | .venv/run.stamp
	@mkdir -p $(@D)
	$(Q)$(SITE)/bin/lcm-gen -c --c-no-pubsub --c-cpath $(@D) --c-hpath $(@D) lcm_types/*_config_t.lcm && touch $@
$(R)/config_file.o: $(R)/gen/stamp $(LIBRARY_IO)
	$(Q)for f in $(R)/gen/*.c; do \
	    $(CC) $(filter-out -MD -MP -fstack-usage,$(CFLAGS)) -I$(R)/gen -w -c $$f -o $${f%.c}.o || exit 1; done
	$(Q)$(LD) -r -o $@ $(LIBRARY_IO) $(R)/gen/*.o
	$(Q)$(OBJCOPY) --strip-debug --wildcard --localize-symbol='*inertiad_lcm_*' $@

$(R)/lib/libinertiad.a: $(CORE) $(R)/config_file.o
$(R)/lib/libinertiad_lcm.a: $(patsubst %.c,$(B)/obj/%.o,$(GEN))
$(R)/lib/%.a:
	@mkdir -p $(@D)
	$(Q)rm -f $@ && $(AR) rcsD $@ $^ && $(OBJCOPY) -D --strip-debug $@

$(R)/lib/libinertiad.so.$(SOVERSION): $(CORE) $(R)/config_file.o
$(R)/lib/libinertiad_lcm.so.$(SOVERSION): $(patsubst %.c,$(B)/obj/%.o,$(GEN)) | $(GEN)
$(R)/lib/libinertiad_lcm.so.$(SOVERSION): LINKED = $(LCM)
$(R)/lib/%.so.$(SOVERSION): $(PACKAGING)/exported.map
	@mkdir -p $(@D)
	$(call say,ld  $@)$(CC) -shared $(SHIPPED) -Wl,-soname,$(@F),--version-script,$< $(filter %.o,$^) $(LINKED) -lm -o $@

# The same programs for three places of liblcm: below a prefix, in the Python packages around a wheel, in the system.
RPATH_PROGRAM_prefix = -Wl,-rpath,'$$ORIGIN/../lib/inertiad/lib'
RPATH_PROGRAM_wheel = -Wl,-rpath,'$$ORIGIN/../../lib'
RPATH_PROGRAM_system =
RELEASED_LIBS = $(B)/lib/libinertiad_io.a $(B)/lib/libinertiad_core.a $(LCM) -pthread -lm
$(R)/prefix/inertiad $(R)/wheel/inertiad $(R)/system/inertiad: $(R)/%/inertiad: $(APP) $(B)/lib/libinertiad_io.a $(B)/lib/libinertiad_core.a
	@mkdir -p $(@D)
	$(call say,ld  $@)$(CC) -pie $(SHIPPED) $(RPATH_PROGRAM_$*) $(APP) $(RELEASED_LIBS) -o $@

# Beside the other Python packages, in every installation.
$(R)/python/inertiad_core.so: $(patsubst %.cpp,$(B)/obj/%.o,$(wildcard host/eigen/python/core/*.cpp))
$(R)/python/%.so: $(B)/obj/host/eigen/python/%.o $(B)/obj/nanobind.o $(B)/lib/libinertiad_io.a $(B)/lib/libinertiad_core.a
	@mkdir -p $(@D)
	$(call say,ld  $@)$(CXX) -shared $(SHIPPED) -Wl,-rpath,'$$ORIGIN/lib' $(filter %.o,$^) $(RELEASED_LIBS) \
	    -Wl,--exclude-libs,ALL -o $@

MAN ?= $(R)/man
$(R)/man/stamp: $(PROGRAMS) $(BINDING) tools/man.py $(wildcard host/inertiad/inertiad/cli/*.py) host/inertiad/inertiad/robot/keys.py
	$(call say,man pages)$(PY) tools/man.py $(@D) && touch $@

RELEASED_FIRMWARE := $(R)/system/inertiad $(addprefix $(R)/lib/,libinertiad.a libinertiad_lcm.a \
    libinertiad.so.$(SOVERSION) libinertiad_lcm.so.$(SOVERSION))
RELEASED := $(R)/prefix/inertiad $(R)/wheel/inertiad $(addprefix $(R)/python/,$(HOST_SO)) $(RELEASED_FIRMWARE)

$(R)/tree.stamp: $(addprefix $(R)/python/,$(HOST_SO)) build/lib/inertiad_feed_forward.so $(GEN) tools/dist.py tools/notice.py LICENSE \
    $(shell find host/inertiad -type f ! -name '*.pyc') | .venv/run.stamp
	$(call say,host tool with its Python packages)$(PY) tools/dist.py tree $(R)/tree && touch $@

## Build what make install copies: programs, libraries, host tool with its Python packages, manual pages
release: build $(RELEASED) $(R)/man/stamp $(R)/tree.stamp
	@touch $(R)/stamp
released:
	@test -e $(R)/stamp || { echo 'make install copies what make release has built: run make release first' >&2; exit 2; }

# Daemon and libraries once more, for Debian on another processor: by Debian's cross compiler, with the liblcm that such
# a machine has. On arm64 itself they are the machine's own, and Ubuntu keeps arm64 in other places. make dist FOREIGN=
# leaves them out.
FOREIGN ?= $(if $(filter x86_64,$(shell uname -m)),$(shell grep -qs '^ID=debian' /etc/os-release && echo arm64))
SYSROOT := build/arm64/sysroot
SYSROOT_LIB := $(SYSROOT)/root/usr/lib/aarch64-linux-gnu
$(SYSROOT)/stamp: tools/sysroot tools/private_apt.sh | .venv/dist.stamp
	$(call say,fetch liblcm for arm64)tools/sysroot arm64 $(@D) libc6 liblcm1 && touch $@
release-arm64: .venv/dist.stamp $(SYSROOT)/stamp $(GEN)
	@$(MAKE) --no-print-directory B=build/arm64 CC=aarch64-linux-gnu-gcc AR=aarch64-linux-gnu-ar LD=aarch64-linux-gnu-ld \
	    OBJCOPY=aarch64-linux-gnu-objcopy LCM='$(SYSROOT_LIB)/liblcm.so.1 -Wl,-rpath-link,$(SYSROOT_LIB)' release-firmware
release-firmware: $(RELEASED_FIRMWARE)
	@touch $(R)/stamp

# Parts of an installation; each package of make dist takes some of them.
put = install -D -m $(1) $(2) $(DESTDIR)$(3)
KIND ?= prefix
BYTECODE ?= yes

install-daemon: released
	$(Q)$(call put,755,$(R)/$(KIND)/inertiad,$(PREFIX)/bin/inertiad)
	$(Q)install -d $(DESTDIR)$(PREFIX)/lib/systemd/system
	$(Q)sed 's#/usr/local/bin/#$(PREFIX)/bin/#' $(PACKAGING)/inertiad.service >$(DESTDIR)$(PREFIX)/lib/systemd/system/inertiad.service
	$(Q)$(call put,644,$(PACKAGING)/70-inertiad-can.rules,$(PREFIX)/lib/udev/rules.d/70-inertiad-can.rules)
	$(Q)$(call put,644,$(PACKAGING)/tmpfiles.conf,$(PREFIX)/lib/tmpfiles.d/inertiad.conf)
	$(Q)$(call put,644,$(PACKAGING)/80-can.network,$(PREFIX)/share/doc/inertiad/examples/80-can.network)
	$(Q)$(call put,644,$(PACKAGING)/README.md,$(PREFIX)/share/doc/inertiad/SERVICE.md)
	$(Q)$(call put,644,CHANGELOG.md,$(PREFIX)/share/doc/inertiad/changelog.md)
	$(Q)$(call put,644,SECURITY.md,$(PREFIX)/share/doc/inertiad/SECURITY.md)
	$(Q)$(call put,644,LICENSE,$(PREFIX)/share/doc/inertiad/LICENSE)
	$(Q)install -d $(DESTDIR)$(PREFIX)/share/inertiad $(DESTDIR)$(PREFIX)/share/man/man8
	$(Q)cp -rT --preserve=mode firmware/robots $(DESTDIR)$(PREFIX)/share/inertiad/robots
	$(Q)cp $(MAN)/inertiad.8.gz $(DESTDIR)$(PREFIX)/share/man/man8/

install-library: released
	$(Q)install -d $(DESTDIR)$(PREFIX)/include/inertiad/batch $(DESTDIR)$(LIBDIR)/pkgconfig $(DESTDIR)$(LIBDIR)/cmake/inertiad \
	    $(DESTDIR)$(PREFIX)/share/inertiad/lcm_types
	$(Q)install -m 644 $(LIBRARY_H) build/gen/*.h host/eigen/include/inertiad/*.hpp $(DESTDIR)$(PREFIX)/include/inertiad/
	$(Q)for f in host/eigen/include/inertiad/batch/*.hpp; do sed 's!#include "\([a-z_]*\.h\)"!#include "../\1"!' $$f \
	    >$(DESTDIR)$(PREFIX)/include/inertiad/batch/$${f##*/} || exit 1; done
	$(Q)install -m 644 $(R)/lib/*.a $(R)/lib/*.so.$(SOVERSION) $(DESTDIR)$(LIBDIR)/
	$(Q)for l in libinertiad libinertiad_lcm; do ln -sf $$l.so.$(SOVERSION) $(DESTDIR)$(LIBDIR)/$$l.so; done
	$(Q)for f in inertiad inertiad_lcm; do sed 's#@LIBDIR@#$(LIBDIR)#;s#@PREFIX@#$(PREFIX)#;s#@VERSION@#$(VERSION)#' \
	    $(PACKAGING)/$$f.pc.in >$(DESTDIR)$(LIBDIR)/pkgconfig/$$f.pc || exit 1; done
	$(Q)for f in inertiadConfig inertiadConfigVersion; do \
	    sed 's#@LIBDIR@#$(LIBDIR)#;s#@PREFIX@#$(PREFIX)#;s#@VERSION@#$(VERSION)#;s#@SOVERSION@#$(SOVERSION)#' \
	    $(PACKAGING)/$$f.cmake.in >$(DESTDIR)$(LIBDIR)/cmake/inertiad/$$f.cmake || exit 1; done
	$(Q)install -m 644 lcm_types/* $(DESTDIR)$(PREFIX)/share/inertiad/lcm_types/

install-tools: released
	$(Q)rm -rf $(DESTDIR)$(PREFIX)/lib/inertiad && install -d $(DESTDIR)$(PREFIX)/lib
	$(Q)cp -rT --preserve=mode $(R)/tree $(DESTDIR)$(PREFIX)/lib/inertiad
	$(Q)[ $(BYTECODE) = no ] || $(SYSTEM_PYTHON) -m compileall -q -j 0 --invalidation-mode checked-hash \
	    $(if $(DESTDIR),-s $(DESTDIR)) $(DESTDIR)$(PREFIX)/lib/inertiad
	$(Q)install -d $(DESTDIR)$(PREFIX)/bin $(DESTDIR)$(PREFIX)/share/man/man1 $(DESTDIR)$(PREFIX)/share/man/man5
	$(Q)sed 's#@PYTHON@#$(SYSTEM_PYTHON)#' $(PACKAGING)/inertiactl.in >$(DESTDIR)$(PREFIX)/bin/inertiactl
	$(Q)chmod 755 $(DESTDIR)$(PREFIX)/bin/inertiactl
	$(Q)cp $(MAN)/*.1.gz $(DESTDIR)$(PREFIX)/share/man/man1/
	$(Q)cp $(MAN)/*.5.gz $(DESTDIR)$(PREFIX)/share/man/man5/
	$(Q)$(call put,644,$(MAN)/inertiactl.bash,$(PREFIX)/share/bash-completion/completions/inertiactl)
	$(Q)$(call put,644,$(MAN)/inertiactl.zsh,$(PREFIX)/share/zsh/site-functions/_inertiactl)
	$(Q)$(call put,644,$(MAN)/inertiactl.fish,$(PREFIX)/share/fish/vendor_completions.d/inertiactl.fish)

## Copy what make release has built: daemon, host tools, library, documents (PREFIX=/usr/local DESTDIR=)
install: install-daemon install-library install-tools

## Remove what make install put there
uninstall:
	rm -rf $(addprefix $(DESTDIR)$(PREFIX)/,lib/inertiad include/inertiad share/inertiad share/doc/inertiad) \
	    $(DESTDIR)$(LIBDIR)/cmake/inertiad
	rm -f $(addprefix $(DESTDIR)$(PREFIX)/,bin/inertiad bin/inertiactl lib/systemd/system/inertiad.service \
	    lib/udev/rules.d/70-inertiad-can.rules lib/tmpfiles.d/inertiad.conf share/man/man8/inertiad.8.gz \
	    share/man/man5/inertiad-robot.toml.5.gz share/bash-completion/completions/inertiactl \
	    share/zsh/site-functions/_inertiactl share/fish/vendor_completions.d/inertiactl.fish) \
	    $(DESTDIR)$(PREFIX)/share/man/man1/inertiactl*.1.gz $(DESTDIR)$(LIBDIR)/libinertiad.* \
	    $(DESTDIR)$(LIBDIR)/libinertiad_lcm.* $(addprefix $(DESTDIR)$(LIBDIR)/pkgconfig/,inertiad.pc inertiad_lcm.pc)

## Install the packages into empty places and use them: programs, and projects in C, C++ and Python
test-install: .venv/test.stamp dist
	@$(PY) tools/test install

## Build packages into build/dist: wheel, .debs, source, SBOM, licences, checksums
dist: .venv/dist.stamp release $(addprefix release-,$(FOREIGN))
	$(Q)$(PY) tools/dist.py dist $(B)/dist $(FOREIGN)

.PHONY: release-arm64 release-firmware
.PHONY: release released install install-daemon install-library install-tools uninstall dist test-install
