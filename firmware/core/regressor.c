// SPDX-License-Identifier: Apache-2.0
#include "regressor.h"

#include <string.h>

void ipe_rate_products(const double w[3], double ww[6])
{
    ww[0] = w[0] * w[0], ww[1] = w[1] * w[1], ww[2] = w[2] * w[2];
    ww[3] = w[1] * w[2], ww[4] = w[0] * w[2], ww[5] = w[0] * w[1];
}

void ipe_regressor(const double s[3], const double ww[6], const double alpha[3], double Y[IPE_NY][IPE_NP])
{
    const double xx = ww[0], yy = ww[1], zz = ww[2], yz = ww[3], xz = ww[4], xy = ww[5];
    const double ax = alpha[0], ay = alpha[1], az = alpha[2];
    const double rows[IPE_NY][IPE_NP] = {
        // m     h: [alpha]x + [w]x[w]x             J: xx   yy       zz       yz        xz        xy
        {s[0], -yy - zz, xy - az, xz + ay, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0},
        {s[1], xy + az, -xx - zz, yz - ax, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0},
        {s[2], xz - ay, yz + ax, -xx - yy, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0},
        {0.0, 0.0, s[2], -s[1], ax, -yz, yz, yy - zz, az + xy, ay - xz},
        {0.0, -s[2], 0.0, s[0], xz, ay, -xz, az - xy, zz - xx, ax + yz},
        {0.0, s[1], -s[0], 0.0, -xy, xy, az, ay + xz, ax - yz, xx - yy},
    };
    memcpy(Y, rows, sizeof rows);
}
