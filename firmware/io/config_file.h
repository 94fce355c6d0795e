// SPDX-License-Identifier: Apache-2.0
/// Compiled configuration (robot.cfg) -> ipe_config_t.
///
/// The file is one LCM-encoded robot_config_t followed by the CRC-32 (IEEE 802.3) of those bytes, big-endian. It holds
/// fixed-size arrays only, so nothing here allocates: about 30 KB of stack while a file is read, none kept. Depends on
/// the generated robot_config_t and on the core, not on liblcm. No state; any thread.
#ifndef IPE_CONFIG_FILE_H
#define IPE_CONFIG_FILE_H

#include "config.h"

#include <stddef.h>
#include <stdint.h>
#include <sys/types.h>

enum { IPE_CONFIG_FILE_MAX = 32768, IPE_CONFIG_CRC_BYTES = 4 };

/// CRC-32 as in Ethernet, zip and PNG.
uint32_t ipe_config_crc(const uint8_t* bytes, size_t n);

/// Decode and check a compiled configuration.
///
///   bytes    in   the whole file, n bytes
///   config   out  filled on IPE_OK; its content is undefined otherwise
///   message  out  one line with the error and its remedy, on failure; size bytes, always terminated
///
/// IPE_OK
/// IPE_ERR_LENGTH  too short to be a configuration
/// IPE_ERR_CONFIG  damaged (CRC), written by another version (fingerprint), or a field out of range
ipe_status_t ipe_config_from_bytes(const uint8_t* bytes, size_t n, ipe_config_t* config, char* message, size_t size);

/// Put another gyro bias [3], rad/s, into a whole compiled configuration of n bytes, CRC included. The rest stays.
///
/// IPE_OK, or IPE_ERR_CONFIG: ipe_config_from_bytes() would refuse it; bytes are unchanged.
ipe_status_t ipe_config_set_gyro_bias(uint8_t* bytes, size_t n, const double bias[3]);

/// The whole file as it is: its length, IPE_CONFIG_FILE_MAX if it is too long for a configuration, -1 with errno set.
ssize_t ipe_config_read(const char* path, uint8_t bytes[IPE_CONFIG_FILE_MAX]);

/// ipe_config_from_bytes() on a file; message begins with its path. Also IPE_ERR_CONFIG when it cannot be read.
ipe_status_t ipe_config_load(const char* path, ipe_config_t* config, char* message, size_t size);

#endif
