// SPDX-License-Identifier: Apache-2.0
/// Locks that keep two daemons from writing the same file or publishing on the same channels.
///
/// Each is held until its descriptor is closed or the process ends, however it ends. No heap, no state, no waiting.
/// Source: flock(2); unix(7), abstract names.
#ifndef IPE_LOCK_H
#define IPE_LOCK_H

#include <netinet/in.h>
#include <stddef.h>

/// Lock a file that is replaced by renaming, through PATH.lock, which is created and stays. The descriptor, or -1 with one
/// line in message[size].
int ipe_lock_file(const char* path, char* message, size_t size);

/// Lock an open regular file. 0, or -1 with errno set: EWOULDBLOCK: another process holds it.
int ipe_lock_descriptor(int fd);

/// Lock the channels that begin with prefix in a multicast group and port, for this host's network namespace.
/// The descriptor, or -1 with one line in message[size].
int ipe_lock_channels(const struct sockaddr_in* group, const char* prefix, char* message, size_t size);

#endif
