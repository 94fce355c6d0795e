// SPDX-License-Identifier: Apache-2.0
#include "cable_inertia.h"

#include "robot.h"

static ipe_config_t config;
static ipe_average_t average;

/// One cable of 10 m and 9.81 N/m, that is 10 kg, straight up from an attachment at the IMU.
void setUp(void)
{
    const double anchor[3] = {0.0, 0.0, 12.0}, p[3] = {0.0, 0.0, 2.0};
    config = cogiro();
    config.n_cables = 1;
    config.cable[0].pulley_radius = 0.0;
    config.cable[0].weight_per_length = 9.81;
    memcpy(config.cable[0].anchor, anchor, sizeof anchor);
    memset(config.cable[0].attachment, 0, sizeof config.cable[0].attachment);
    memset(config.imu_position, 0, sizeof config.imu_position);
    memset(&average, 0, sizeof average);
    memcpy(average.p, p, sizeof p);
    for (int i = 0; i < 3; ++i) { average.R[i][i] = 1.0; }
    average.s[2] = 9.81;  // no acceleration yet
}

void tearDown(void)
{
}

static void check_force(double x, double y, double z)
{
    const double expected[3] = {x, y, z};
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_cable_inertia_add(&config, &average));
    for (int i = 0; i < 3; ++i) {
        TEST_ASSERT_DOUBLE_WITHIN(1e-9, expected[i], average.y[i]);
        TEST_ASSERT_EQUAL_DOUBLE(average.cable_inertia[i], average.y[i]);
    }
}

static void test_cable_at_rest_has_no_inertia(void)
{
    check_force(0.0, 0.0, 0.0);
}

static void test_a_third_of_the_mass_moves_across_the_line(void)
{
    average.s[0] = 3.0, average.s[2] += 3.0;  // when: also along the line, where the sensor measures it
    check_force(-10.0, 0.0, 0.0);             // then: 10 kg / 3 * 3 m/s2
}

static void test_at_the_winch_all_of_the_mass_moves_along_the_line(void)
{
    config.cable[0].force_at = IPE_FORCE_AT_WINCH;
    average.s[0] = 3.0, average.s[2] += 3.0;
    check_force(-10.0, 0.0, -30.0);
}

static void test_attachment_takes_part_in_the_rotation(void)
{
    const double arm[3] = {0.0, 0.5, 0.0};
    memcpy(config.cable[0].attachment, arm, sizeof arm);
    config.cable[0].anchor[1] = 0.5;
    average.alpha[2] = 4.0;              // when: the attachment is driven along -x by 2 m/s2
    average.ww[2] = 9.0;                 // and to the centre by 4.5 m/s2
    check_force(20.0 / 3.0, 15.0, 0.0);  // then
    TEST_ASSERT_DOUBLE_WITHIN(1e-9, -0.5 * 20.0 / 3.0, average.y[5]);
}

static void test_wrench_is_in_platform_axes(void)
{
    const double turn[3] = {0.3, -0.2, 0.5};
    double force[3], expected[3];
    mat3_exp(turn, average.R);
    const double specific[3] = {3.0, -1.0, 9.81};  // W
    mat3_tmul_vec((const double (*)[3])average.R, specific, average.s);
    const double in_world[3] = {-10.0, 10.0 / 3.0, 0.0};
    mat3_tmul_vec((const double (*)[3])average.R, in_world, expected);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_cable_inertia_add(&config, &average));
    memcpy(force, average.y, sizeof force);
    for (int i = 0; i < 3; ++i) { TEST_ASSERT_DOUBLE_WITHIN(1e-9, expected[i], force[i]); }
}

static void test_cable_without_direction_is_refused_and_nothing_added(void)
{
    memcpy(average.p, config.cable[0].anchor, sizeof average.p);
    average.s[0] = 3.0;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_GEOMETRY, ipe_cable_inertia_add(&config, &average));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, average.y[0]);
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_cable_at_rest_has_no_inertia);
    RUN_TEST(test_a_third_of_the_mass_moves_across_the_line);
    RUN_TEST(test_at_the_winch_all_of_the_mass_moves_along_the_line);
    RUN_TEST(test_attachment_takes_part_in_the_rotation);
    RUN_TEST(test_wrench_is_in_platform_axes);
    RUN_TEST(test_cable_without_direction_is_refused_and_nothing_added);
    return UNITY_END();
}
