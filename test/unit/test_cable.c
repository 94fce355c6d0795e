// SPDX-License-Identifier: Apache-2.0
#include "cable.h"

#include "robot.h"

static ipe_cable_t cable;
static ipe_cable_line_t line;
static uint64_t seed;

void setUp(void)
{
    seed = 17;
    memset(&line, 0, sizeof line);
    cable = (ipe_cable_t){
        .anchor = {-7.2, 5.4, 5.4}, .pulley_radius = 0.05, .swivel_axis = {0.0, 0.0, 1.0}, .weight_per_length = 0.628};
}

void tearDown(void)
{
}

static double distance(const double a[3], const double b[3])
{
    double d[3];
    vec3_axpy(a, -1.0, b, d);
    return vec3_norm(d);
}

static double length_at(const double B[3])
{
    ipe_cable_line_t l;
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_cable_line(&cable, B, &l));
    return l.length;
}

/// dl/dB = -u by central differences, |leave - B| = free, the cable tangent to the pulley, u unit.
static void check_laws(const double B[3])
{
    const double h = 1e-5 * fmin(1.0, 10.0 * cable.pulley_radius + 0.1);
    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_cable_line(&cable, B, &line));
    for (int i = 0; i < 3; ++i) {
        double plus[3] = {B[0], B[1], B[2]}, minus[3] = {B[0], B[1], B[2]};
        plus[i] += h, minus[i] -= h;
        TEST_ASSERT_DOUBLE_WITHIN(1e-6, -line.u[i], (length_at(plus) - length_at(minus)) / (2.0 * h));
    }
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, line.free, distance(line.leave, B));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0, vec3_norm(line.u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, line.free + cable.pulley_radius * line.wrap, line.length);
    const double* k = cable.swivel_axis;
    double d[3], e[3], centre[3], spoke[3];
    vec3_axpy(B, -1.0, cable.anchor, d);
    vec3_axpy(d, -vec3_dot(d, k), k, e);
    vec3_axpy(cable.anchor, cable.pulley_radius / vec3_norm(e), e, centre);
    vec3_axpy(line.leave, -1.0, centre, spoke);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, cable.pulley_radius, vec3_norm(spoke));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, vec3_dot(spoke, line.u));
}

static void random_unit(double v[3])
{
    fill_normal(&seed, v, 3);
    const double n = vec3_norm(v);
    for (int i = 0; i < 3; ++i) { v[i] /= n; }
}

static void test_line_laws_hold_at_random_points_axes_and_radii(void)
{
    for (int n = 0; n < 2000; ++n) {  // given: any axis, radius, point outside the disc
        random_unit(cable.swivel_axis);
        cable.pulley_radius = between(&seed, 0.01, 0.5);
        double B[3], direction[3];
        random_unit(direction);
        vec3_axpy(cable.anchor, between(&seed, 2.2 * cable.pulley_radius, 12.0), direction, B);
        double e[3];
        vec3_axpy(direction, -vec3_dot(direction, cable.swivel_axis), cable.swivel_axis, e);
        if (vec3_norm(e) < 0.05) { continue; }  // too near the swivel axis for differences
        check_laws(B);                          // when, then
    }
}

static void test_line_point_below_and_inside_two_radii_wraps_past_half_turn(void)
{
    cable.pulley_radius = 0.1;                        // given: B below A, 0.12 m out: less than 2 r
    const double B[3] = {cable.anchor[0] + 0.12, cable.anchor[1], cable.anchor[2] - 4.0};
    check_laws(B);                                    // when
    TEST_ASSERT_GREATER_THAN_INT(0, line.wrap > PI);  // then
    TEST_ASSERT_LESS_THAN_INT(1, line.wrap > 1.1 * PI);
}

static void test_line_point_straight_below_far_side_wraps_half_a_turn(void)
{
    const double B[3] = {cable.anchor[0] + 0.1, cable.anchor[1], cable.anchor[2] - 4.0};  // given: 2 r out
    check_laws(B);                                                                        // when
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, PI, line.wrap);                                      // then: hangs straight down
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.0, line.u[2]);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 4.0, line.free);
}

static void test_line_point_above_and_close_wraps_little(void)
{
    const double B[3] = {cable.anchor[0] + 0.02, cable.anchor[1], cable.anchor[2] + 5.0};  // given: along the axis
    check_laws(B);                                                                         // when
    ASSERT_BELOW(0.02, line.wrap);                                                         // then
}

static void test_line_inclined_axis_of_a_known_case(void)
{
    cable = (ipe_cable_t){.pulley_radius = 1.0, .swivel_axis = {1.0, 0.0, 0.0}};  // given: cable runs along x, turns
    const double B[3] = {1.0, 0.0, -10.0};                                        // to -z after a quarter of a turn

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_cable_line(&cable, B, &line));              // when

    const double leave[3] = {1.0, 0.0, -1.0}, u[3] = {0.0, 0.0, 1.0};             // then
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.5 * PI, line.wrap);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 9.0, line.free);
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, distance(leave, line.leave));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, distance(u, line.u));
}

static void test_line_zero_radius_is_a_point(void)
{
    cable.pulley_radius = 0.0;  // given
    const double B[3] = {-4.2, 9.4, 5.4};

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_cable_line(&cable, B, &line));  // when

    const double u[3] = {-0.6, -0.8, 0.0};                            // then
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 0.0, distance(u, line.u));
    TEST_ASSERT_EQUAL_DOUBLE(0.0, line.wrap);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 5.0, line.free);
    TEST_ASSERT_DOUBLE_WITHIN(1e-15, 5.0, line.length);
    TEST_ASSERT_EQUAL_DOUBLE(0.0, distance(line.leave, cable.anchor));
}

static void test_line_vanishing_radius_tends_to_the_point(void)
{
    const double B[3] = {0.3, -0.4, 2.0};  // given
    ipe_cable_line_t point;
    cable.pulley_radius = 0.0;
    (void)ipe_cable_line(&cable, B, &point);
    cable.pulley_radius = 1e-9;

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_cable_line(&cable, B, &line));  // when

    TEST_ASSERT_DOUBLE_WITHIN(1e-9, 0.0, distance(point.u, line.u));  // then
    TEST_ASSERT_DOUBLE_WITHIN(1e-8, point.length, line.length);
}

static void check_refused(double x, double y, double z)
{
    const double B[3] = {cable.anchor[0] + x, cable.anchor[1] + y, cable.anchor[2] + z};
    const ipe_cable_line_t before = line;
    TEST_ASSERT_EQUAL_INT(IPE_ERR_GEOMETRY, ipe_cable_line(&cable, B, &line));
    TEST_ASSERT_EQUAL_MEMORY(&before, &line, sizeof line);
}

static void test_line_point_without_direction_is_refused(void)
{
    line.free = 123.0;               // given: a line that must stay
    check_refused(0.0, 0.0, -4.0);   // when, then: on the swivel axis
    check_refused(0.05, 0.0, 0.01);  // inside the disc
    check_refused(0.0, 0.1, 0.0);    // on the disc's edge
    check_refused(NAN, 0.0, -4.0);
    cable.pulley_radius = 0.0;
    check_refused(0.0, 0.0, 0.0);  // on the point anchor
    check_refused(0.0, NAN, 0.0);
}

static void test_sag_is_half_the_weight_across_the_line(void)
{
    const double B[3] = {0.3, -0.4, 2.0};  // given
    double force[3];
    (void)ipe_cable_line(&cable, B, &line);

    ipe_cable_sag(&cable, &line, force);          // when

    const double half = 0.5 * 0.628 * line.free;  // then: nothing along u, weight's share down
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 0.0, vec3_dot(force, line.u));
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, -half * (1.0 - line.u[2] * line.u[2]), force[2]);
}

/// Shape of a uniform cable from B to D under tension T at B in direction v, integrated from its differential equation.
static void end_of_hanging_cable(double weight, double length, double T, const double v[3], double end[3])
{
    enum { STEPS = 20000 };
    double force[3], at[3] = {0.0, 0.0, 0.0};
    for (int i = 0; i < 3; ++i) { force[i] = T * v[i]; }  // on the rest of the cable, pulls towards the anchor
    for (int s = 0; s < STEPS; ++s) {
        force[2] += 0.5 * weight * length / STEPS;
        const double size = vec3_norm(force);
        for (int i = 0; i < 3; ++i) { at[i] += length / STEPS * force[i] / size; }
        force[2] += 0.5 * weight * length / STEPS;
    }
    memcpy(end, at, sizeof at);
}

static void test_sag_agrees_with_hanging_cable(void)
{
    cable.pulley_radius = 0.0;  // given: 8.5 m of CoGiRo's cable at 1000 N
    const double B[3] = {0.0, 0.0, 0.0}, T = 1000.0;
    double v[3] = {-0.6, 0.5, 0.0};
    v[2] = sqrt(1.0 - v[0] * v[0] - v[1] * v[1]);
    end_of_hanging_cable(cable.weight_per_length, 8.5, T, v, cable.anchor);
    (void)ipe_cable_line(&cable, B, &line);
    double sag[3], difference[3];

    ipe_cable_sag(&cable, &line, sag);                                                    // when: straight line and sag

    for (int i = 0; i < 3; ++i) { difference[i] = T * v[i] - (T * line.u[i] + sag[i]); }  // then
    ASSERT_BELOW(0.05, vec3_norm(difference));
}

static void test_sensor_at_the_winch_also_carries_the_weight_along_the_line(void)
{
    cable = (ipe_cable_t){.anchor = {0.0, 0.0, 5.0}, .swivel_axis = {0.0, 0.0, 1.0}, .weight_per_length = 2.0};
    const double B[3] = {3.0, 0.0, 1.0};  // given: 5 m long, 4 m high
    double platform[3], winch[3];

    TEST_ASSERT_EQUAL_INT(IPE_OK, ipe_cable_line(&cable, B, &line));
    ipe_cable_sag(&cable, &line, platform);
    cable.force_at = IPE_FORCE_AT_WINCH;
    ipe_cable_sag(&cable, &line, winch);  // when
    for (int i = 0; i < 3; ++i) {         // then: the tension below is 2 N/m times 4 m smaller
        TEST_ASSERT_DOUBLE_WITHIN(1e-12, -8.0 * line.u[i], winch[i] - platform[i]);
    }
}

static void test_friction_of_a_pulley_goes_with_its_wrap(void)
{
    cable = (ipe_cable_t){.pulley_radius = 0.05, .force_at = IPE_FORCE_AT_WINCH};
    line = (ipe_cable_line_t){.wrap = 0.75 * 3.14159265358979};
    TEST_ASSERT_DOUBLE_WITHIN(1e-12, 1.5, ipe_cable_friction_share(&cable, &line));
    cable.force_at = IPE_FORCE_AT_PLATFORM;
    TEST_ASSERT_EQUAL_DOUBLE(1.0, ipe_cable_friction_share(&cable, &line));
}

int main(void)
{
    UNITY_BEGIN();
    RUN_TEST(test_line_laws_hold_at_random_points_axes_and_radii);
    RUN_TEST(test_line_point_below_and_inside_two_radii_wraps_past_half_turn);
    RUN_TEST(test_line_point_straight_below_far_side_wraps_half_a_turn);
    RUN_TEST(test_line_point_above_and_close_wraps_little);
    RUN_TEST(test_line_inclined_axis_of_a_known_case);
    RUN_TEST(test_line_zero_radius_is_a_point);
    RUN_TEST(test_line_vanishing_radius_tends_to_the_point);
    RUN_TEST(test_line_point_without_direction_is_refused);
    RUN_TEST(test_sag_is_half_the_weight_across_the_line);
    RUN_TEST(test_sag_agrees_with_hanging_cable);
    RUN_TEST(test_sensor_at_the_winch_also_carries_the_weight_along_the_line);
    RUN_TEST(test_friction_of_a_pulley_goes_with_its_wrap);
    return UNITY_END();
}
