// SPDX-License-Identifier: Apache-2.0
#include "consistency.h"

#include "smallmat.h"

#include <string.h>

void ipe_consistency_pseudo_inertia(const double theta[IPE_NP], double Pi[4][4])
{
    const double* J = theta + 4;
    const double half_trace = 0.5 * (J[0] + J[1] + J[2]);
    const double entries[4][4] = {
        {half_trace - J[0], -J[5], -J[4], theta[1]},
        {-J[5], half_trace - J[1], -J[3], theta[2]},
        {-J[4], -J[3], half_trace - J[2], theta[3]},
        {theta[1], theta[2], theta[3], theta[0]},
    };
    memcpy(Pi, entries, sizeof entries);
}

bool ipe_consistency_check(const double theta[IPE_NP])
{
    double Pi[4][4];
    ipe_consistency_pseudo_inertia(theta, Pi);
    return cholesky(&Pi[0][0], 4);
}
