// SPDX-License-Identifier: Apache-2.0
#include "checkpoint.h"

#include "config_file.h"
#include "robot.h"
#include "temp_file.h"

#include <sys/stat.h>
#include <time.h>

#define MS 1000000LL

enum { N_SAMPLES = 1500, STEP_MS = 2, FILE_BYTES = sizeof(ipe_checkpoint_state_t) + 4 };

static const uint8_t CONFIG[] = "stands for the compiled configuration";
static ipe_config_t config;
static ipe_pipeline_t warm, other;
static ipe_checkpoint_t checkpoint;
static double truth[IPE_NP];
static char folder[32], path[64], message[512];
static uint8_t bytes[FILE_BYTES];

static void push(ipe_pipeline_t* p, uint32_t can_id, int64_t t_ns, const void* data, size_t n, const ipe_frame_t* more)
{
    ipe_frame_t f = *more;
    f.t_ns = t_ns;
    f.can_id = can_id;
    f.flags = IPE_FRAME_FD;
    memcpy(f.data, data, n);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_pipeline_push_frame(p, &f));
}

/// The motion from sample first to end, from the sensors to the estimate.
static void run(ipe_pipeline_t* p, int first, int end)
{
    for (int k = first; k < end; ++k) {
        const ideal_t x = ideal_at(&config, 1e-3 * STEP_MS * k, truth);
        const int64_t t_ns = 1000000000 + k * STEP_MS * MS;
        const uint32_t time_us = 1000U * STEP_MS * (unsigned)k;
        const uint16_t counter = (uint16_t)k;
        ipe_frame_t a = {.length = LENGTH_IMU_A}, b = {.length = LENGTH_IMU_B}, f = {.length = LENGTH_FORCE};
        memcpy(a.data + 24, x.gyro, sizeof x.gyro);
        memcpy(a.data + 48, &counter, sizeof counter);
        memcpy(a.data + 52, &time_us, sizeof time_us);
        push(p, ID_IMU_A, t_ns, x.acc, sizeof x.acc, &a);
        push(p, ID_IMU_B, t_ns, x.q, sizeof x.q, &b);
        push(p, ID_FORCE, t_ns, x.f, sizeof x.f, &f);
        (void)ipe_pipeline_push_position(p, t_ns, x.position);
        ipe_row_t row;
        while (ipe_pipeline_step(p, &row, NULL) != IPE_NOT_READY) {}
    }
}

static void init(ipe_pipeline_t* p)
{
    TEST_ASSERT_EQUAL_INT_MESSAGE(IPE_OK, ipe_pipeline_init(p, &config, message, sizeof message), message);
}

static void open_it(void)
{
    TEST_ASSERT_EQUAL_MESSAGE(0, ipe_checkpoint_open(&checkpoint, path, CONFIG, sizeof CONFIG, message, sizeof message),
                              message);
}

/// The file of the warm pipeline, also in bytes.
static void write_it(void)
{
    open_it();
    TEST_ASSERT_EQUAL(0, ipe_checkpoint_close(&checkpoint, &warm));
    FILE* file = fopen(path, "rb");
    TEST_ASSERT_NOT_NULL(file);
    TEST_ASSERT_EQUAL(FILE_BYTES, fread(bytes, 1, sizeof bytes, file));
    TEST_ASSERT_EQUAL(EOF, fgetc(file));
    (void)fclose(file);
}

static void write_bytes(size_t n)
{
    FILE* file = fopen(path, "wb");
    TEST_ASSERT_NOT_NULL(file);
    TEST_ASSERT_EQUAL(n, fwrite(bytes, 1, n, file));
    (void)fclose(file);
}

static int load(ipe_pipeline_t* p)
{
    return ipe_checkpoint_load(&checkpoint, p, message, sizeof message);
}

/// The file is refused for this reason and the cold pipeline stays as it was.
static void assert_refused(const char* reason)
{
    static ipe_pipeline_t before;
    init(&other);
    before = other;
    TEST_ASSERT_EQUAL(-1, load(&other));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(message, reason), message);
    TEST_ASSERT_EQUAL_MEMORY(&before, &other, sizeof other);
}

void setUp(void)
{
    static bool is_warm;
    (void)snprintf(folder, sizeof folder, "/tmp/inertiad-XXXXXX");
    TEST_ASSERT_NOT_NULL(mkdtemp(folder));
    (void)snprintf(path, sizeof path, "%s/state", folder);
    if (is_warm) { return; }
    config = cogiro();
    nominal_theta(truth);
    init(&warm);
    run(&warm, 0, N_SAMPLES);
    is_warm = true;
}

void tearDown(void)
{
    (void)unlink(path);
    TEST_ASSERT_EQUAL(0, rmdir(folder));  // no temporary left behind either
}

static void test_checkpoint_restart_continues_the_estimate(void)
{
    write_it();
    init(&other);
    TEST_ASSERT_EQUAL_MESSAGE(1, load(&other), message);
    TEST_ASSERT_EQUAL_MEMORY(&warm.estimator.rls, &other.estimator.rls, sizeof warm.estimator.rls);
    TEST_ASSERT_EQUAL_MEMORY(&warm.estimator.estimate, &other.estimator.estimate, sizeof warm.estimator.estimate);
    TEST_ASSERT_TRUE(warm.window.period == other.window.period &&
                     warm.estimator.n_excited == other.estimator.n_excited);
    run(&other, 5 * N_SAMPLES, 6 * N_SAMPLES);  // when: 12 s later
    TEST_ASSERT_TRUE(ipe_pipeline_invariants_hold(&other));
    TEST_ASSERT_GREATER_THAN_UINT64(warm.estimator.estimate.n_windows, other.estimator.estimate.n_windows);
    TEST_ASSERT_EQUAL_UINT64(warm.estimator.change_detector.n_changes, other.estimator.change_detector.n_changes);
    ASSERT_BELOW(warm.estimator.estimate.body.mass_std, other.estimator.estimate.body.mass_std);
    for (int i = 0; i < 6; ++i) {
        ASSERT_BELOW(1.001 * warm.estimator.estimate.body.inertia_cog_std[i],
                     other.estimator.estimate.body.inertia_cog_std[i]);
    }
    ASSERT_BELOW(3.0 * other.estimator.estimate.body.mass_std, fabs(other.estimator.estimate.body.mass - truth[0]));
}

static void test_checkpoint_of_a_contact_restarts_with_the_body_before(void)
{
    double step[IPE_NP] = {30.0}, std[IPE_NP] = {1.0};
    const ipe_estimator_t before = warm.estimator;
    ipe_publication_t moved;
    ipe_estimator_begin_publication(&warm.estimator, &config, before.estimate.t_ns, step, std, &moved);
    ipe_status_t status = IPE_UNFINISHED;
    while (status == IPE_UNFINISHED) { status = ipe_estimator_go_on_publication(&warm.estimator, &config, &moved); }
    TEST_ASSERT_EQUAL_INT(IPE_OK, status);
    TEST_ASSERT_TRUE(warm.estimator.estimate.is_provisional);
    write_it();
    warm.estimator = before;
    init(&other);
    TEST_ASSERT_EQUAL_MESSAGE(1, load(&other), message);  // when
    TEST_ASSERT_FALSE(other.estimator.estimate.is_provisional);
    TEST_ASSERT_EQUAL_DOUBLE(before.estimate.body.mass, other.estimator.estimate.body.mass);
    TEST_ASSERT_EQUAL_UINT64(before.estimate.n_changes + 1, other.estimator.estimate.n_changes);
}

static void test_checkpoint_that_is_not_there_is_a_cold_start(void)
{
    open_it();
    init(&other);
    TEST_ASSERT_EQUAL(0, load(&other));
    TEST_ASSERT_EQUAL(0, ipe_checkpoint_close(&checkpoint, &other));
    TEST_ASSERT_EQUAL(-1, access(path, F_OK));  // nothing was learnt, nothing is kept
}

static void test_checkpoint_torn_anywhere_is_refused(void)
{
    write_it();
    for (size_t n = 0; n < FILE_BYTES; n += n < 64 || n > FILE_BYTES - 16 ? 1 : 97) {
        write_bytes(n);
        init(&other);
        TEST_ASSERT_EQUAL(-1, load(&other));
        TEST_ASSERT_EQUAL_UINT64(0, other.estimator.estimate.n_windows);
    }
    write_bytes(FILE_BYTES - 1);
    assert_refused("torn");
}

static void test_checkpoint_with_a_wrong_bit_is_refused(void)
{
    write_it();
    for (size_t i = 0; i < FILE_BYTES; i += 61) {
        bytes[i] ^= 0x10;
        write_bytes(FILE_BYTES);
        bytes[i] ^= 0x10;
        init(&other);
        TEST_ASSERT_EQUAL(-1, load(&other));
    }
    bytes[FILE_BYTES / 2] ^= 1;
    write_bytes(FILE_BYTES);
    assert_refused("CRC differs");
}

static void seal(void)
{
    const uint32_t crc = ipe_config_crc(bytes, sizeof(ipe_checkpoint_state_t));
    memcpy(bytes + sizeof(ipe_checkpoint_state_t), &crc, sizeof crc);
    write_bytes(FILE_BYTES);
}

static void test_checkpoint_of_another_version_or_impossible_is_refused(void)
{
    write_it();
    bytes[offsetof(ipe_checkpoint_state_t, version)] ^= 0xFF;
    seal();
    assert_refused("another version");
    bytes[offsetof(ipe_checkpoint_state_t, version)] ^= 0xFF;
    bytes[offsetof(ipe_checkpoint_state_t, estimator.estimate.is_provisional)] = 7;
    seal();
    assert_refused("cannot be");
    bytes[offsetof(ipe_checkpoint_state_t, estimator.estimate.is_provisional)] = 0;
    memset(bytes + offsetof(ipe_checkpoint_state_t, estimator.rls.D), 0xFF, sizeof(double));  // NaN
    seal();
    assert_refused("cannot be");
}

static void test_checkpoint_of_another_configuration_is_refused(void)
{
    write_it();
    TEST_ASSERT_EQUAL(0, ipe_checkpoint_open(&checkpoint, path, CONFIG, sizeof CONFIG - 1, message, sizeof message));
    assert_refused("another configuration");
    TEST_ASSERT_EQUAL(0, ipe_checkpoint_close(&checkpoint, &other));
    write_bytes(0);  // nothing was learnt: nothing overwrote it
    assert_refused("torn");
}

static void test_checkpoint_save_is_written_meanwhile(void)
{
    const struct timespec pause = {.tv_nsec = 10000000};
    open_it();
    ipe_checkpoint_save(&checkpoint, &warm);
    for (int i = 0; i < 500 && atomic_load(&checkpoint.n_written) == 0; ++i) { (void)nanosleep(&pause, NULL); }
    init(&other);
    TEST_ASSERT_EQUAL_MESSAGE(1, load(&other), message);
    TEST_ASSERT_EQUAL(0, ipe_checkpoint_close(&checkpoint, &warm));
    TEST_ASSERT_EQUAL_UINT64(2, atomic_load(&checkpoint.n_written));
}

static void test_checkpoint_that_cannot_be_written_is_told(void)
{
    char nowhere[96];
    (void)snprintf(nowhere, sizeof nowhere, "%s/nowhere/state", folder);
    TEST_ASSERT_EQUAL(-1, ipe_checkpoint_open(&checkpoint, nowhere, CONFIG, 1, message, sizeof message));
    TEST_ASSERT_NOT_NULL(strstr(message, "No such file"));
    char moved[64];
    (void)snprintf(moved, sizeof moved, "%s.moved", folder);
    open_it();
    TEST_ASSERT_EQUAL(0, rename(folder, moved));  // when: the folder goes away
    TEST_ASSERT_EQUAL(-1, ipe_checkpoint_close(&checkpoint, &warm));
    TEST_ASSERT_EQUAL_UINT64(1, atomic_load(&checkpoint.n_errors));
    TEST_ASSERT_EQUAL(0, rename(moved, folder));
}

int main(void)
{
    UNITY_BEGIN();
    silence_stderr();
    RUN_TEST(test_checkpoint_restart_continues_the_estimate);
    RUN_TEST(test_checkpoint_of_a_contact_restarts_with_the_body_before);
    RUN_TEST(test_checkpoint_that_is_not_there_is_a_cold_start);
    RUN_TEST(test_checkpoint_torn_anywhere_is_refused);
    RUN_TEST(test_checkpoint_with_a_wrong_bit_is_refused);
    RUN_TEST(test_checkpoint_of_another_version_or_impossible_is_refused);
    RUN_TEST(test_checkpoint_of_another_configuration_is_refused);
    RUN_TEST(test_checkpoint_save_is_written_meanwhile);
    RUN_TEST(test_checkpoint_that_cannot_be_written_is_told);
    return UNITY_END();
}
