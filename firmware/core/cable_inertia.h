// SPDX-License-Identifier: Apache-2.0
/// The cables' own inertia, added to a window's wrench.
///
/// A straight cable of weight w per length and free length L, held at the pulley, turns with its platform end: of its mass a
/// third moves with the attachment across the line u. The force on the platform at attachment B is
///   -(w L / 3 g)(I - u u^T) a_B             and, where the force sensor sits at the winch, -(w L / g)(u . a_B) u more:
/// the tension there also drives the cable along its line. a_B = a_I + ([alpha]x + [w]x[w]x)(b - i) is taken from the
/// window's averages at its middle pose.
/// The cable must stay straight: it holds below about half the first transverse frequency sqrt(f g / w)/(2 L) of each cable
/// (CoGiRo 4 Hz, 2.5 N/m on it 2 Hz, facades of 30 m 0.5 Hz). The true force is 4 % larger at a quarter of it, 22 % at half.
/// Source: firmware/DESIGN.md, "Cables". No state, any thread, 1 us per window of 8 cables.
#ifndef IPE_CABLE_INERTIA_H
#define IPE_CABLE_INERTIA_H

#include "config.h"
#include "types.h"
#include "window.h"

/// Add the inertia of all cables that have weight to average->y.
///
/// IPE_OK, or IPE_ERR_GEOMETRY: a cable has no direction at the window's pose, average untouched.
ipe_status_t ipe_cable_inertia_add(const ipe_config_t* config, ipe_average_t* average);

#endif
