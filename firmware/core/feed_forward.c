// SPDX-License-Identifier: Apache-2.0
#include "feed_forward.h"

#include "regressor.h"

#include <string.h>

void ipe_feed_forward(const double theta[IPE_NP], const double R[3][3], const double a[3], const double w[3],
                      const double alpha[3], double gravity, double wrench[IPE_NY], double Y[IPE_NY][IPE_NP])
{
    double s[3], ww[6], derivative[IPE_NY][IPE_NP];
    for (int i = 0; i < 3; ++i) { s[i] = R[0][i] * a[0] + R[1][i] * a[1] + R[2][i] * (a[2] + gravity); }
    ipe_rate_products(w, ww);
    ipe_regressor(s, ww, alpha, derivative);
    for (int j = 0; j < IPE_NY; ++j) {
        wrench[j] = 0.0;
        for (int k = 0; k < IPE_NP; ++k) { wrench[j] += derivative[j][k] * theta[k]; }
    }
    if (Y != NULL) { memcpy(Y, derivative, sizeof derivative); }
}
