// SPDX-License-Identifier: Apache-2.0
/// Over real datagram sockets, with a path and in the abstract namespace.
#include "notify.h"

#include "temp_file.h"

#include <errno.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <unity.h>

static ipe_notify_t notify;
static int manager = -1;
static char name[64], received[1024];

static void listen_at(const char* path)
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    memcpy(address.sun_path, path, strlen(path));
    if (path[0] == '@') { address.sun_path[0] = '\0'; }
    manager = socket(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0);
    const socklen_t n = (socklen_t)(offsetof(struct sockaddr_un, sun_path) + strlen(path));
    TEST_ASSERT_EQUAL(0, bind(manager, (const struct sockaddr*)&address, n));
    TEST_ASSERT_EQUAL(0, setenv("NOTIFY_SOCKET", path, 1));
}

static const char* receive(void)
{
    const ssize_t n = recv(manager, received, sizeof received - 1, 0);
    if (n < 0) { return NULL; }
    received[n] = '\0';
    return received;
}

void setUp(void)
{
    (void)unsetenv("NOTIFY_SOCKET");
    (void)unsetenv("WATCHDOG_USEC");
    (void)unsetenv("WATCHDOG_PID");
    (void)snprintf(name, sizeof name, "/tmp/inertiad-notify-%d", (int)getpid());
}

void tearDown(void)
{
    ipe_notify_close(&notify);
    if (manager >= 0) { (void)close(manager); }
    manager = -1;
    (void)unlink(name);
}

static void test_notify_lines_arrive_in_one_datagram(void)
{
    listen_at(name);
    TEST_ASSERT_EQUAL(0, ipe_notify_open(&notify));
    ipe_notify_send(&notify, "READY=1\nSTATUS=%d frames", 7);
    TEST_ASSERT_EQUAL_STRING("READY=1\nSTATUS=7 frames", receive());
    TEST_ASSERT_NULL(receive());
}

static void test_notify_reaches_the_abstract_namespace(void)
{
    name[0] = '@';
    listen_at(name);
    TEST_ASSERT_EQUAL(0, ipe_notify_open(&notify));
    ipe_notify_send(&notify, "STOPPING=1");
    TEST_ASSERT_EQUAL_STRING("STOPPING=1", receive());
}

static void test_notify_without_a_manager_does_nothing(void)
{
    TEST_ASSERT_EQUAL(0, ipe_notify_open(&notify));
    TEST_ASSERT_EQUAL(-1, notify.fd);
    ipe_notify_send(&notify, "READY=1");
    TEST_ASSERT_EQUAL_UINT64(0, notify.n_failed);
}

static void test_notify_bad_addresses_are_refused(void)
{
    const char* const bad[] = {"", "relative", "/", "@"};
    for (unsigned i = 0; i < sizeof bad / sizeof bad[0]; ++i) {
        (void)setenv("NOTIFY_SOCKET", bad[i], 1);
        TEST_ASSERT_EQUAL(-1, ipe_notify_open(&notify));
        TEST_ASSERT_EQUAL_INT(EINVAL, errno);
    }
}

static void test_notify_long_text_is_cut_and_a_gone_manager_counted(void)
{
    listen_at(name);
    TEST_ASSERT_EQUAL(0, ipe_notify_open(&notify));
    ipe_notify_send(&notify, "STATUS=%0600d", 0);
    TEST_ASSERT_EQUAL(511, strlen(receive()));
    (void)close(manager);
    manager = -1;
    ipe_notify_send(&notify, "WATCHDOG=1");
    TEST_ASSERT_EQUAL_UINT64(1, notify.n_failed);
}

static void test_notify_watchdog_is_ours_only_if_it_names_us(void)
{
    char pid[16];
    listen_at(name);
    (void)setenv("WATCHDOG_USEC", "2500000", 1);
    TEST_ASSERT_EQUAL(0, ipe_notify_open(&notify));
    TEST_ASSERT_EQUAL_INT64(2500000000, notify.watchdog_ns);
    ipe_notify_close(&notify);
    (void)snprintf(pid, sizeof pid, "%d", (int)getpid() + 1);
    (void)setenv("WATCHDOG_PID", pid, 1);
    TEST_ASSERT_EQUAL(0, ipe_notify_open(&notify));
    TEST_ASSERT_EQUAL_INT64(0, notify.watchdog_ns);
    ipe_notify_close(&notify);
    (void)setenv("WATCHDOG_USEC", "soon", 1);
    (void)unsetenv("WATCHDOG_PID");
    TEST_ASSERT_EQUAL(0, ipe_notify_open(&notify));
    TEST_ASSERT_EQUAL_INT64(0, notify.watchdog_ns);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_notify_lines_arrive_in_one_datagram);
    RUN_TEST(test_notify_reaches_the_abstract_namespace);
    RUN_TEST(test_notify_without_a_manager_does_nothing);
    RUN_TEST(test_notify_bad_addresses_are_refused);
    RUN_TEST(test_notify_long_text_is_cut_and_a_gone_manager_counted);
    RUN_TEST(test_notify_watchdog_is_ours_only_if_it_names_us);
    return UNITY_END();
}
