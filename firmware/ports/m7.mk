# SPDX-License-Identifier: Apache-2.0
# make m7: the core for a Cortex-M7, run by an emulator, beside the same program for this machine.

M7 := firmware/ports/cortex_m7
M7_FLAGS = -std=gnu11 -O2 -DIPE_PROFILE_MICRO -DIPE_FDCAN_EMULATED -fno-math-errno -ffp-contract=off -ffunction-sections \
    -fdata-sections -I$(M7) -I$(R)/gen -Ifirmware/core -Ifirmware/io -isystem $(SITE)/include
M7_TARGET := -mcpu=cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard -mthumb
M7_CORE = $(patsubst %.c,$(B)/m7/%.o,$(wildcard firmware/core/*.c) firmware/io/config_file.c firmware/io/crc.c \
    $(addprefix $(M7)/,main.c frame_ring.c fdcan.c mps2_an500.c runtime.c))
M7_GEN = $(patsubst lcm_types/%.lcm,$(B)/m7/gen/inertiad_lcm_%.o,$(wildcard lcm_types/*_config_t.lcm))

$(B)/m7/gen/%.o: $(R)/gen/stamp
	@mkdir -p $(@D)
	$(Q)arm-none-eabi-gcc $(M7_TARGET) $(M7_FLAGS) -w -fcallgraph-info=su -c $(R)/gen/$*.c -o $@
$(B)/m7/%.o: %.c $(R)/gen/stamp
	@mkdir -p $(@D)
	$(call say,m7  $<)arm-none-eabi-gcc $(M7_TARGET) $(M7_FLAGS) -Wall -Wextra -MD -MP -fcallgraph-info=su -c $< -o $@
$(B)/m7/firmware.elf: $(M7_CORE) $(M7_GEN) $(M7)/mps2_an500.ld
	$(call say,ld  $@)arm-none-eabi-gcc $(M7_TARGET) -nostartfiles -Wl,--gc-sections -Wl,-Map,$(B)/m7/firmware.map \
	    -T $(M7)/mps2_an500.ld $(filter %.o,$^) -lm -lc -lgcc -o $@

$(B)/m7/workstation: $(R)/gen/stamp $(wildcard $(M7)/*.[ch] firmware/core/*.[ch] firmware/io/*.[ch])
	@mkdir -p $(@D)
	$(call say,ld  $@)$(CC) $(M7_FLAGS) -Wl,--gc-sections $(wildcard firmware/core/*.c) firmware/io/config_file.c \
	    firmware/io/crc.c $(R)/gen/inertiad_lcm_*_config_t.c $(addprefix $(M7)/,main.c frame_ring.c fdcan.c workstation.c) -lm -o $@

## Run the core on an emulated Cortex-M7: bits against this machine's, instructions, stack, heap, state
m7: .venv/m7.stamp build $(B)/m7/firmware.elf $(B)/m7/workstation
	$(Q)$(PY) tools/m7.py

.PHONY: m7
-include $(M7_CORE:.o=.d)
