// SPDX-License-Identifier: Apache-2.0
#include "config.h"

#include "robot.h"

#include <stddef.h>

static ipe_config_t config;
static char message[256];

void setUp(void)
{
    config = cogiro();
    memset(message, 0, sizeof message);
}

void tearDown(void)
{
}

static void check_refused(const char* expected)
{
    TEST_ASSERT_EQUAL_INT_MESSAGE(IPE_ERR_CONFIG, ipe_config_check(&config, message, sizeof message), expected);
    TEST_ASSERT_EQUAL_STRING(expected, message);
    TEST_ASSERT_NULL(strchr(message, '\n'));
}

static void test_check_good_robot_is_accepted_and_says_nothing(void)
{
    strcpy(message, "untouched");                                                       // given
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_config_check(&config, message, sizeof message));  // when
    TEST_ASSERT_EQUAL_STRING("untouched", message);                                     // then
}

#define AT(field) offsetof(ipe_config_t, field)

/// One number put into a double field of the good robot, and the message that must name field, value and range.
static const struct {
    size_t at;
    double value;
    const char* message;
} REAL[] = {
    {AT(gravity), -9.81, "gravity = -9.81: allowed 0 .. 1000 m/s2"},
    {AT(gravity), NAN, "gravity = nan: allowed 0 .. 1000 m/s2"},
    {AT(cable[2].anchor[1]), 1e5, "cable.anchor[1] = 100000: allowed -10000 .. 10000 m"},
    {AT(cable[7].attachment[2]), -2e3, "cable.attachment[2] = -2000: allowed -1000 .. 1000 m"},
    {AT(cable[3].pulley_radius), -0.05, "cable.pulley_radius[3] = -0.05: allowed 0 .. 10 m"},
    {AT(cable[3].swivel_axis[0]), 0.1, "cable.swivel_axis[3] = 1.00498756: length of a unit vector, allowed 1 +- 1e-6"},
    {AT(cable[3].swivel_axis[2]), NAN, "cable.swivel_axis[3] = nan: length of a unit vector, allowed 1 +- 1e-6"},
    {AT(cable[1].weight_per_length), -1.0, "cable.weight_per_length[1] = -1: allowed 0 .. 10000 N/m"},
    {AT(cable[0].tension_min), -1.0, "cable.tension_min[0] = -1: allowed 0 .. 1e+07 N"},
    {AT(cable[0].tension_max), 99.0, "cable.tension_max[0] = 99: allowed 100 .. 1e+08 N"},
    {AT(imu_position[0]), INFINITY, "imu_position[0] = inf: allowed -1000 .. 1000 m"},
    {AT(imu_orientation[0]), 0.9, "imu_orientation = 0.9: length of a unit vector, allowed 1 +- 1e-6"},
    {AT(tracker_target[2]), 2e3, "tracker_target[2] = 2000: allowed -1000 .. 1000 m"},
    {AT(sample_rate), -1.0, "sample_rate = -1: allowed 0 .. 100000 Hz"},
    {AT(fixed_position[1]), 2e4, "fixed_position[1] = 20000: allowed -10000 .. 10000 m"},
    {AT(signal[4].scale), 0.0, "signal.scale[4] = 0: allowed 1e-30 .. 1e+30 in magnitude"},
    {AT(signal[4].scale), NAN, "signal.scale[4] = nan: allowed 1e-30 .. 1e+30 in magnitude"},
    {AT(signal[4].offset), INFINITY, "signal.offset[4] = inf: allowed -1e+30 .. 1e+30 "},
    {AT(signal[4].maximum), -1.0, "signal.maximum[4] = -1: allowed 0 .. inf "},
    {AT(signal[4].minimum), NAN, "signal.minimum[4] = nan: allowed -inf .. inf "},
    {AT(bus_bitrate[3]), -1.0, "bus_bitrate[3] = -1: allowed 1 .. 1e+08 bit/s, or 0: unknown"},
    {AT(bus_data_bitrate[0]), 1e-300, "bus_data_bitrate[0] = 1e-300: allowed 1 .. 1e+08 bit/s, or 0: unknown"},
    {AT(max_wait), 11.0, "max_wait = 11: allowed 0 .. 10 s"},
    {AT(max_age[2]), 0.0, "max_age[2] = 0: allowed 1e-06 .. 10 s"},
    {AT(max_carry), -0.1, "max_carry = -0.1: allowed 0 .. 10 s"},
    {AT(delay[1]), -1.5, "delay[1] = -1.5: allowed -1 .. 1 s"},
    {AT(delay_attitude), 1.5, "delay_attitude = 1.5: allowed -1 .. 1 s"},
    {AT(acc_bias[0]), 30.0, "acc_bias[0] = 30: allowed -20 .. 20 m/s2"},
    {AT(gyro_bias[0]), 2.0, "gyro_bias[0] = 2: allowed -1 .. 1 rad/s"},
    {AT(attitude_bias[0]), 2.0, "attitude_bias[0] = 2: allowed -1 .. 1 rad"},
    {AT(world_yaw), 8.0, "world_yaw = 8: allowed -7 .. 7 rad"},
    {AT(force_offset[15]), 2e6, "force_offset[15] = 2000000: allowed -1e+06 .. 1e+06 N"},
    {AT(force_gain[0]), -1.0, "force_gain[0] = -1: allowed -0.9 .. 9 "},
    {AT(std_acc_bias), -1.0, "std_acc_bias = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_gyro_bias), NAN, "std_gyro_bias = nan: allowed 0 .. 1e+06 SI"},
    {AT(std_attitude), -1.0, "std_attitude = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_world_yaw), -1.0, "std_world_yaw = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_imu_alignment), -1.0, "std_imu_alignment = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_imu_position), -1.0, "std_imu_position = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_force_offset), -1.0, "std_force_offset = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_force_gain), -1.0, "std_force_gain = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_force_delay), -1.0, "std_force_delay = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_position_delay), -1.0, "std_position_delay = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_geometry), 1e7, "std_geometry = 10000000: allowed 0 .. 1e+06 SI"},
    {AT(std_tracker_target), -1.0, "std_tracker_target = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_attitude_delay), NAN, "std_attitude_delay = nan: allowed 0 .. 1e+06 SI"},
    {AT(std_friction), -1.0, "std_friction = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_force_offset_drift), -1.0, "std_force_offset_drift = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_acc_scale), -1.0, "std_acc_scale = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_gyro_scale), -1.0, "std_gyro_scale = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_external_force), -1.0, "std_external_force = -1: allowed 0 .. 1e+06 SI"},
    {AT(std_external_stiffness), NAN, "std_external_stiffness = nan: allowed 0 .. 1e+06 SI"},
    {AT(external_attachment[1]), 2e3, "external_attachment[1] = 2000: allowed -1000 .. 1000 m"},
    {AT(external_reference[2]), NAN, "external_reference[2] = nan: allowed -10000 .. 10000 m"},
    {AT(window_length), 0.0, "window_length = 0: allowed 0.01 .. 10 s"},
    {AT(residual_covariance[2][2]), -4.0, "residual_covariance = 4: must be positive definite"},
    {AT(residual_covariance[2][1]), 0.5, "residual_covariance[13] = 0.5: must be symmetric"},
    {AT(prior_theta[9]), NAN, "prior_theta[9] = nan: allowed -1e+09 .. 1e+09 SI"},
    {AT(prior_covariance[9][9]), 0.0, "prior_covariance = 10000: must be positive definite"},
    {AT(prior_covariance[3][0]), NAN, "prior_covariance[30] = nan: must be symmetric"},
    {AT(memory), 1.0, "memory = 1: allowed 10 .. 1e+09 s, or 0: for ever"},
    {AT(memory), NAN, "memory = nan: allowed 10 .. 1e+09 s, or 0: for ever"},
    {AT(estimate_rate), 0.0, "estimate_rate = 0: allowed 0.01 .. 10000 Hz"},
};

static void test_check_real_out_of_range_is_refused_by_name_value_and_range(void)
{
    for (size_t i = 0; i < sizeof REAL / sizeof REAL[0]; ++i) {
        config = cogiro();               // given
        memcpy((char*)&config + REAL[i].at, &REAL[i].value, sizeof(double));
        check_refused(REAL[i].message);  // when, then
    }
}

/// The same for int32 fields.
static const struct {
    size_t at;
    int32_t value;
    const char* message;
} INTEGER[] = {
    {AT(n_cables), 0, "n_cables = 0: allowed 1 .. 16 "},
    {AT(n_cables), 17, "n_cables = 17: allowed 1 .. 16 "},
    {AT(attitude_source), 0, "attitude_source = 0: allowed 1 .. 2 "},
    {AT(attitude_estimate), 2, "attitude_estimate = 2: allowed 0 .. 1 (fused needs a measured position)"},
    {AT(cable[3].force_at), 2, "cable.force_at[3] = 2: allowed 0 .. 1 "},
    {AT(position_source), 3, "position_source = 3: allowed 0 .. 2 "},
    {AT(n_signals), 0, "n_signals = 0: allowed 1 .. 64 "},
    {AT(n_signals), 65, "n_signals = 65: allowed 1 .. 64 "},
    {AT(signal[5].quantity), IPE_Q_COUNT, "signal.quantity[5] = 38: allowed 0 .. 37 "},
    {AT(signal[5].bus), 8, "signal.bus[5] = 8: allowed 0 .. 7 "},
    {AT(signal[5].can_id), 0x800, "signal.can_id[5] = 2048: allowed 0 .. 2047 "},
    {AT(signal[5].can_id), (int32_t)(IPE_CAN_EFF | IPE_CAN_RTR),
     "signal.can_id[5] = 1.07374182e+09: allowed 0 .. 5.36871e+08 "},
    {AT(signal[5].frame_length), 65, "signal.frame_length[5] = 65: allowed 1 .. 64 bytes"},
    {AT(signal[5].length), 65, "signal.length[5] = 65: allowed 1 .. 64 bits"},
    {AT(signal[5].start), -1, "signal.start[5] = -1: allowed 0 .. 511 "},
    {AT(signal[5].start), 449, "signal last bit[5] = 512: allowed 0 .. 511 in its frame"},
    {AT(signal[5].kind), 3, "signal.kind[5] = 3: allowed 0 .. 2 "},
    {AT(signal[5].kind), IPE_FLOAT32, "signal.length[5] = 64: allowed 32 .. 32 bits for float32"},
    {AT(signal[6].kind), IPE_FLOAT64, "signal.length[6] = 16: allowed 64 .. 64 bits for float64"},
    {AT(signal[5].mux_start), 512, "signal.mux_start[5] = 512: allowed -1 .. 511 "},
    {AT(signal[5].mux_start), 0, "signal.mux_length[5] = 0: allowed 1 .. 32 bits"},
    {AT(signal[0].quantity), IPE_Q_ACC_X + 1, "acc[0] = 0: no CAN signal is bound to it"},
    {AT(signal[5].quantity), IPE_Q_GYRO_X, "gyro[2] = 0: no CAN signal is bound to it"},
    {AT(signal[11].quantity), IPE_Q_QUAT_W, "quaternion[3] = 0: no CAN signal is bound to it"},
    {AT(attitude_source), IPE_ATTITUDE_RPY, "roll pitch yaw[0] = 0: no CAN signal is bound to it"},
    {AT(position_source), IPE_POSITION_CAN, "position[0] = 0: no CAN signal is bound to it"},
    {AT(signal[19].quantity), IPE_Q_F_1, "force[7] = 0: no CAN signal is bound to it"},
};

static void test_check_integer_out_of_range_is_refused_by_name_value_and_range(void)
{
    for (size_t i = 0; i < sizeof INTEGER / sizeof INTEGER[0]; ++i) {
        config = cogiro();                  // given
        memcpy((char*)&config + INTEGER[i].at, &INTEGER[i].value, sizeof(int32_t));
        check_refused(INTEGER[i].message);  // when, then
    }
}

static void test_check_fused_attitude_with_a_fixed_position_is_refused(void)
{
    config.attitude_estimate = IPE_ATTITUDE_FUSED;  // given
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_config_check(&config, message, sizeof message));
    config.position_source = IPE_POSITION_FIXED;
    check_refused("attitude_estimate = 1: allowed 0 .. 0 (fused needs a measured position)");  // when, then
}

static void test_check_motorola_signal_past_its_frame_is_refused(void)
{
    ipe_signal_t* s = &config.signal[6];  // given: 16 bits from the last byte on
    s->big_endian = true;
    s->start = 8 * 63 + 7;
    check_refused("signal last bit[6] = 519: allowed 0 .. 511 in its frame");  // when, then
    s->start = 8 * 62 + 7;
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_config_check(&config, message, sizeof message));
}

static void test_check_one_to_sixteen_cables_are_accepted(void)
{
    for (int n = 1; n <= 16; ++n) {
        config = cogiro();  // given
        config.n_cables = n;
        for (int i = 8; i < n; ++i) {
            config.cable[i] = config.cable[i - 8];
            config.signal[config.n_signals++] = wide_signal(IPE_Q_F_1 + i, 0x21, 64, 8 * (i - 8));
        }
        TEST_ASSERT_EQUAL_INT_MESSAGE(IPE_OK, ipe_config_check(&config, message, sizeof message),
                                      message);  // when, then
    }
}

static void test_check_first_fault_is_the_one_told(void)
{
    config.gravity = -1.0;  // given
    config.estimate_rate = -1.0;
    config.n_cables = 99;
    check_refused("gravity = -1: allowed 0 .. 1000 m/s2");  // when, then
}

static void test_check_short_message_buffer_is_terminated(void)
{
    char small[8] = "xxxxxxx";                                                              // given
    config.gravity = -1.0;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_CONFIG, ipe_config_check(&config, small, sizeof small));  // when
    TEST_ASSERT_EQUAL_STRING("gravity", small);                                             // then
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_check_good_robot_is_accepted_and_says_nothing);
    RUN_TEST(test_check_real_out_of_range_is_refused_by_name_value_and_range);
    RUN_TEST(test_check_integer_out_of_range_is_refused_by_name_value_and_range);
    RUN_TEST(test_check_fused_attitude_with_a_fixed_position_is_refused);
    RUN_TEST(test_check_motorola_signal_past_its_frame_is_refused);
    RUN_TEST(test_check_one_to_sixteen_cables_are_accepted);
    RUN_TEST(test_check_first_fault_is_the_one_told);
    RUN_TEST(test_check_short_message_buffer_is_terminated);
    return UNITY_END();
}
