// SPDX-License-Identifier: Apache-2.0
/// Where the kernel has no CAN: CAN sockets as UDP sockets on loopback, in any program this library is preloaded into.
///
/// Interface "vcanN" is a port; who sets an empty receive filter sends to it, who else binds receives from it, one at a
/// time. Stamps, drop counters, batches and buffers are the kernel's as for CAN, so what a receiver costs is like on a
/// vcan, where frames also pass from the sender's system call into the receiver's queue. Filters are not applied, and
/// there are no error frames. RECEIVE_BUFFER_MAX in the environment, bytes, is what an unprivileged process may have.
#ifndef _GNU_SOURCE
#define _GNU_SOURCE  // RTLD_NEXT
#endif
#include <arpa/inet.h>
#include <dlfcn.h>
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

enum { FDS = 1024, FIRST_PORT = 29500, BUSES = 8 };

typedef struct {
    bool is_can, is_sender;
    int index;  ///< of the interface, from 1
} can_t;

static can_t can[FDS];

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static can_t* can_of(int fd)
{
    return fd >= 0 && fd < FDS && can[fd].is_can ? &can[fd] : NULL;
}

int socket(int domain, int type, int protocol)
{
    if (domain != PF_CAN) { return REAL(socket)(domain, type, protocol); }
    const int fd = REAL(socket)(AF_INET, SOCK_DGRAM | (type & (SOCK_CLOEXEC | SOCK_NONBLOCK)), 0);
    if (fd >= 0 && fd < FDS) { can[fd] = (can_t){.is_can = true}; }
    return fd;
}

int setsockopt(int fd, int level, int name, const void* value, socklen_t size)
{
    can_t* c = can_of(fd);
    const char* most = c != NULL && level == SOL_SOCKET ? getenv("RECEIVE_BUFFER_MAX") : NULL;
    if (most != NULL && name == SO_RCVBUFFORCE) {
        errno = EPERM;
        return -1;
    }
    if (most != NULL && name == SO_RCVBUF) {
        const int n = atoi(most);
        return REAL(setsockopt)(fd, level, name, &n, sizeof n);
    }
    if (c == NULL || level != SOL_CAN_RAW) { return REAL(setsockopt)(fd, level, name, value, size); }
    if (name == CAN_RAW_FILTER && size == 0) { c->is_sender = true; }
    return 0;
}

int bind(int fd, const struct sockaddr* address, socklen_t size)
{
    can_t* c = can_of(fd);
    if (c == NULL) { return REAL(bind)(fd, address, size); }
    c->index = ((const struct sockaddr_can*)(const void*)address)->can_ifindex;
    const struct sockaddr_in port = {.sin_family = AF_INET,
                                     .sin_port = htons((uint16_t)(FIRST_PORT + c->index)),
                                     .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    const struct sockaddr* to = (const struct sockaddr*)(const void*)&port;
    return c->is_sender ? connect(fd, to, sizeof port) : REAL(bind)(fd, to, sizeof port);
}

ssize_t recvmsg(int fd, struct msghdr* message, int flags)
{
    const can_t* c = can_of(fd);
    void* name = message->msg_name;
    const socklen_t n_name = message->msg_namelen;
    if (c == NULL) { return REAL(recvmsg)(fd, message, flags); }
    message->msg_name = NULL;
    message->msg_namelen = 0;
    const ssize_t n = REAL(recvmsg)(fd, message, flags);
    message->msg_name = name;
    message->msg_namelen = n_name;
    if (n >= 0 && name != NULL) {
        const struct sockaddr_can from = {.can_family = AF_CAN, .can_ifindex = c->index};
        message->msg_namelen = n_name < sizeof from ? n_name : sizeof from;
        memcpy(name, &from, message->msg_namelen);
    }
    return n;
}

/// 0: no bus of ours.
static unsigned index_of(const char* name)
{
    unsigned bus;
    char end;
    return sscanf(name, "vcan%u%c", &bus, &end) == 1 && bus < BUSES ? bus + 1 : 0;
}

unsigned if_nametoindex(const char* name)
{
    return index_of(name) != 0 ? index_of(name) : REAL(if_nametoindex)(name);
}

int ioctl(int fd, unsigned long request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    void* argument = va_arg(arguments, void*);
    va_end(arguments);
    struct ifreq* r = argument;
    if (request == SIOCGIFNAME && can_of(fd) != NULL) {
        (void)snprintf(r->ifr_name, sizeof r->ifr_name, "vcan%d", r->ifr_ifindex - 1);
        return 0;
    }
    if ((request == SIOCGIFINDEX || request == SIOCGIFFLAGS || request == SIOCGIFMTU) && can_of(fd) != NULL &&
        index_of(r->ifr_name) != 0) {
        if (request == SIOCGIFINDEX) { r->ifr_ifindex = (int)index_of(r->ifr_name); }
        if (request == SIOCGIFFLAGS) { r->ifr_flags = IFF_UP | IFF_RUNNING; }
        if (request == SIOCGIFMTU) { r->ifr_mtu = CANFD_MTU; }
        return 0;
    }
    return REAL(ioctl)(fd, request, argument);
}
