// SPDX-License-Identifier: Apache-2.0
/// One cable over a swivelling pulley: direction, length and weight. No state, any thread.
///
/// Entry point A, swivel axis k (unit, cable travel direction at A, winch to pulley), radius r to the centre line,
/// platform point B, d = B - A. The pulley swivels about k so that its plane holds B:
///   d_k = d.k,  e = (d - d_k k)/|..|,  d_e = d.e,  C = A + r e                      pulley centre
///   L^2 = |d|^2 - 2 r d_e,  q = L^2 + r^2                                           free length
///   sin b = (L (d_e - r) + r d_k)/q,  cos b = (L d_k - r (d_e - r))/q               wrap angle
///   D = A + r ((1 - cos b) e + sin b k)                                             leave point
///   u = (D - B)/L,  l = r b + L,  dl/dB = -u                                        direction, length
/// Cable weight w per length bends the cable; its platform end carries, beside the tension along u, half the weight
/// across it: (w L/2)(-z + (z.u) u). Where the force sensor sits at the winch, the tension it measures is larger than the
/// platform's by the weight of the free cable along u, w L z.u.  Source: firmware/DESIGN.md, "Cables".
#ifndef IPE_CABLE_H
#define IPE_CABLE_H

#include "config.h"
#include "types.h"

typedef struct {
    double u[3];      ///< unit vector in W from the platform point to the leave point
    double free;      ///< length from leave point to platform point, m
    double wrap;      ///< angle on the pulley, rad, 0 .. 2 pi
    double length;    ///< arc and free length, m
    double leave[3];  ///< leave point in W, m
} ipe_cable_line_t;

/// Line of the cable to the platform point B [3] in W, m.
///
/// IPE_OK; IPE_ERR_GEOMETRY: B inside the pulley's disc, on the swivel axis of a pulley (no direction to swivel to) or
/// on the anchor; line untouched. About 40 ns.
ipe_status_t ipe_cable_line(const ipe_cable_t* cable, const double B[3], ipe_cable_line_t* line);

/// Force of the cable's own weight on the platform beside the measured tension along u, W, N.
void ipe_cable_sag(const ipe_cable_t* cable, const ipe_cable_line_t* line, double force[3]);

/// Share of a pulley's friction that a cable's wrap makes: in quarter turns, since rope on a pulley loses tension in
/// proportion to its wrap (capstan). 1 where the force sensor does not lie behind a pulley of known radius.
double ipe_cable_friction_share(const ipe_cable_t* cable, const ipe_cable_line_t* line);

#endif
