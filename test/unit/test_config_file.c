// SPDX-License-Identifier: Apache-2.0
#include "config_file.h"

#include "robot.h"
#include "temp_file.h"

#include "inertiad_lcm_robot_config_t.h"

static inertiad_lcm_robot_config_t wire;
static uint8_t bytes[IPE_CONFIG_FILE_MAX];
static size_t n_bytes;
static ipe_config_t config;
static char message[256];

static void seal(size_t n)
{
    const uint32_t crc = ipe_config_crc(bytes, n);
    for (int i = 0; i < 4; ++i) { bytes[n + (size_t)i] = (uint8_t)(crc >> (24 - 8 * i)); }
    n_bytes = n + 4;
}

static void encode(void)
{
    const int n = inertiad_lcm_robot_config_t_encode(bytes, 0, IPE_CONFIG_FILE_MAX, &wire);
    TEST_ASSERT_GREATER_THAN(0, n);
    seal((size_t)n);
}

/// CoGiRo with one signal as inertiactl would write it.
static void make_wire(void)
{
    const ipe_config_t k = cogiro();
    memset(&wire, 0, sizeof wire);
    memcpy(wire.name, k.name, sizeof wire.name);
    wire.gravity = k.gravity;
    wire.n_cables = k.n_cables;
    for (int i = 0; i < k.n_cables; ++i) {
        memcpy(wire.cable[i].anchor, k.cable[i].anchor, sizeof k.cable[i].anchor);
        memcpy(wire.cable[i].attachment, k.cable[i].attachment, sizeof k.cable[i].attachment);
        memcpy(wire.cable[i].swivel_axis, k.cable[i].swivel_axis, sizeof k.cable[i].swivel_axis);
        wire.cable[i].pulley_radius = k.cable[i].pulley_radius;
        wire.cable[i].tension_max = k.cable[i].tension_max;
    }
    memcpy(wire.imu_position, k.imu_position, sizeof k.imu_position);
    memcpy(wire.prior_covariance, k.prior_covariance, sizeof k.prior_covariance);
    wire.n_signals = 1;
    wire.signal[0] = (inertiad_lcm_signal_config_t){.quantity = IPE_Q_F_1,
                                                    .bus = 2,
                                                    .can_id = INT32_MIN + 5,
                                                    .is_signed = 1,
                                                    .mux_start = -1,
                                                    .mux_value = -7,
                                                    .scale = 0.5};
}

void setUp(void)
{
    make_wire();
    encode();
    memset(&config, 0, sizeof config);
    message[0] = '\0';
}

void tearDown(void)
{
    remove_temp_files();
}

static void check_refused(ipe_status_t status, const char* reason)
{
    TEST_ASSERT_EQUAL(status, ipe_config_from_bytes(bytes, n_bytes, &config, message, sizeof message));
    TEST_ASSERT_NOT_NULL_MESSAGE(strstr(message, reason), message);
}

static void test_config_crc_is_the_ieee_one(void)
{
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926, ipe_config_crc((const uint8_t*)"123456789", 9));
}

static void test_config_fields_arrive_in_their_places(void)
{
    const ipe_config_t k = cogiro();
    (void)ipe_config_from_bytes(bytes, n_bytes, &config, message, sizeof message);
    TEST_ASSERT_EQUAL_STRING("CoGiRo", config.name);
    TEST_ASSERT_EQUAL_MEMORY(k.cable[7].anchor, config.cable[7].anchor, sizeof k.cable[7].anchor);
    TEST_ASSERT_EQUAL_MEMORY(k.imu_position, config.imu_position, sizeof k.imu_position);
    TEST_ASSERT_EQUAL_MEMORY(k.prior_covariance, config.prior_covariance, sizeof k.prior_covariance);
    TEST_ASSERT_EQUAL_HEX32(IPE_CAN_EFF | 5, config.signal[0].can_id);
    TEST_ASSERT_EQUAL(2, config.signal[0].bus);
    TEST_ASSERT_TRUE(config.signal[0].is_signed);
    TEST_ASSERT_FALSE(config.signal[0].big_endian);
    TEST_ASSERT_EQUAL(-1, config.signal[0].mux_start);
    TEST_ASSERT_EQUAL_INT64(-7, config.signal[0].mux_value);
}

static void test_config_no_byte_is_left_out(void)
{
    enum { FINGERPRINT = 8, NAME = FINGERPRINT, NAME_END = NAME + sizeof wire.name - 1 };
    static ipe_config_t other;
    const size_t n = n_bytes - 4;
    (void)ipe_config_from_bytes(bytes, n_bytes, &config, message, sizeof message);
    for (size_t i = FINGERPRINT; i < n; ++i) {
        if (i == NAME_END) { continue; }  // ends the name, whatever is sent
        bytes[i] ^= 1;
        seal(n);
        memset(&other, 0, sizeof other);
        (void)ipe_config_from_bytes(bytes, n_bytes, &other, message, sizeof message);
        (void)snprintf(message, sizeof message, "byte %zu of %zu may be anything", i, n);
        TEST_ASSERT_TRUE_MESSAGE(memcmp(&config, &other, sizeof config) != 0, message);
        bytes[i] ^= 1;
    }
}

static void test_config_any_flipped_bit_is_damage(void)
{
    for (size_t i = 0; i < n_bytes; i += 97) {
        bytes[i] ^= (uint8_t)(1U << (i % 8));
        check_refused(IPE_ERR_CONFIG, "damaged");
        bytes[i] ^= (uint8_t)(1U << (i % 8));
    }
}

static void test_config_cut_anywhere_is_refused(void)
{
    const size_t n_whole = n_bytes;
    for (n_bytes = 0; n_bytes < n_whole; n_bytes += n_bytes < 20 ? 1 : 501) {
        check_refused(n_bytes <= 12 ? IPE_ERR_LENGTH : IPE_ERR_CONFIG, n_bytes <= 12 ? "too short" : "damaged");
    }
}

static void test_config_of_another_version_is_named_so(void)
{
    bytes[3] ^= 1;  // another fingerprint under a right CRC
    seal(n_bytes - 4);
    check_refused(IPE_ERR_CONFIG, "another version");
    encode();
    seal(n_bytes);  // right fingerprint, four bytes too many
    check_refused(IPE_ERR_CONFIG, "another version");
}

static void test_config_out_of_range_names_field_and_value(void)
{
    wire.n_cables = 17;
    encode();
    check_refused(IPE_ERR_CONFIG, "n_cables");
}

static void test_config_load_names_the_file(void)
{
    const char* path = temp_file_of(bytes, 100);
    TEST_ASSERT_EQUAL(IPE_ERR_CONFIG, ipe_config_load(path, &config, message, sizeof message));
    TEST_ASSERT_EQUAL_STRING_LEN(path, message, strlen(path));
    TEST_ASSERT_EQUAL(IPE_ERR_CONFIG, ipe_config_load("/nonexistent.cfg", &config, message, sizeof message));
    TEST_ASSERT_EQUAL_STRING("/nonexistent.cfg: No such file or directory", message);
}

static void test_set_gyro_bias_changes_nothing_else(void)
{
    const double bias[3] = {0.1, -0.2, 0.3};
    (void)ipe_config_from_bytes(bytes, n_bytes, &config, message, sizeof message);
    ipe_config_t expected;
    memcpy(&expected, &config, sizeof expected);
    memcpy(expected.gyro_bias, bias, sizeof bias);
    TEST_ASSERT_EQUAL(IPE_OK, ipe_config_set_gyro_bias(bytes, n_bytes, bias));
    (void)ipe_config_from_bytes(bytes, n_bytes, &config, message, sizeof message);
    TEST_ASSERT_EQUAL_MEMORY(&expected, &config, sizeof config);
    TEST_ASSERT_EQUAL(IPE_ERR_CONFIG, ipe_config_set_gyro_bias(bytes, n_bytes - 8, bias));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_config_crc_is_the_ieee_one);
    RUN_TEST(test_config_fields_arrive_in_their_places);
    RUN_TEST(test_config_no_byte_is_left_out);
    RUN_TEST(test_config_any_flipped_bit_is_damage);
    RUN_TEST(test_config_cut_anywhere_is_refused);
    RUN_TEST(test_config_of_another_version_is_named_so);
    RUN_TEST(test_config_out_of_range_names_field_and_value);
    RUN_TEST(test_config_load_names_the_file);
    RUN_TEST(test_set_gyro_bias_changes_nothing_else);
    return UNITY_END();
}
