// SPDX-License-Identifier: Apache-2.0
/// An announced payload: while it comes into contact, its share that the platform already carries.
///
///   e_k = x_k Y_k d + noise       d: ten parameters of the announced payload, x_k: share of it in window k
/// e_k is the innovation of a window under the body before. It has 40 ms, or 8 rows where these take longer (below 200 Hz), and a
/// new one begins every quarter of it; the estimator's own are ten times longer and average over the contact. The demands on
/// that step are those of change_detector.h on a sudden change; only its direction is known beforehand. As long as the noise is
/// only declared, it counts as four times that, so that a push at the start is none.
///
///   waits    from 1 s before the announced time; two windows in a row, each alone, show a share above 0
///   contact  the estimate is the body before plus x d, extrapolated to the present, and provisional; the filter's windows are
///            not used. Its begin counts as a change of payload
///   taken    the share rests for 20 windows (0.2 s), at 1 within 3 sigma: theta moves by x d, uncertain as announced
///   other    it rests elsewhere: theta moves by x d, and is loosened as by any change of payload
///   failed   five windows in a row show no share of d, or the contact takes over 3 s: the body before is published again, which
///            counts as a change, too; what follows is suspected as usual
///   missed   30 s after the announced time nothing has come: nothing has changed
/// After taken, other and failed the filter's windows begin anew. A push that rests at 1 within 3 sigma is taken, too: the
/// announcement is believed.
/// Source: firmware/DESIGN.md, "Change". 8 KB of state, caller-allocated, no heap, one thread.
#ifndef IPE_ANNOUNCEMENT_H
#define IPE_ANNOUNCEMENT_H

#include "config.h"
#include "estimator.h"
#include "types.h"
#include "window.h"

enum {
    IPE_ANNOUNCEMENT_SHARES = 20,  ///< windows that must agree: 0.2 s
    IPE_ANNOUNCEMENT_NUMBERS = 20  ///< mass, its sigma, CoG 3, sigmas 3, inertia about it 6, sigmas 6
};

typedef enum {
    IPE_ANNOUNCEMENT_NONE = 0,  ///< nothing is announced, or no longer
    IPE_ANNOUNCEMENT_WAITS,
    IPE_ANNOUNCEMENT_CONTACT,
    IPE_ANNOUNCEMENT_TAKEN,
    IPE_ANNOUNCEMENT_OTHER,
    IPE_ANNOUNCEMENT_FAILED,
    IPE_ANNOUNCEMENT_MISSED,
} ipe_announcement_state_t;

typedef struct {
    ipe_announcement_state_t state;
    int64_t from_ns;                        ///< announced time of the contact
    double step[IPE_NP];                    ///< what it adds to theta about the IMU
    double std[IPE_NP];                     ///< of that where its mass is known
    double relative_std;                    ///< of its mass
    ipe_window_t window;
    bool has_looked;                        ///< a window could be compared: there was an estimate
    int n_evident;                          ///< windows in a row, up to now, that show a share
    int n_failed;                           ///< in a contact: windows in a row that do not
    int64_t contact_ns;                     ///< first window of the contact
    int n_shares;
    double share[IPE_ANNOUNCEMENT_SHARES];  ///< of the newest windows, window k at k % IPE_ANNOUNCEMENT_SHARES,
    double t[IPE_ANNOUNCEMENT_SHARES];      ///< s since contact_ns, their middles
    double now, now_std;                    ///< share at present
    int64_t shown_ns;                       ///< instant to publish for
} ipe_announcement_t;

/// Begin to wait.
///
///   body     numbers in the order of IPE_ANNOUNCEMENT_NUMBERS, about P, P axes: kg, m, kg m2; a negative mass is set down, with
///            the CoG and the inertia of what is set down
///   from_ns  host time of the contact
///   period   s between rows, 0: not known
///
/// IPE_OK; IPE_ERR_RANGE: a number is not finite, mass 0, a sigma negative, that of the mass over half of it, or no such body
/// can exist: the reason is in message[size], a not changed.
ipe_status_t ipe_announcement_init(ipe_announcement_t* a, const ipe_config_t* config,
                                   const double body[IPE_ANNOUNCEMENT_NUMBERS], int64_t from_ns, double period,
                                   char* message, size_t size);

/// A row's motion and wrench. IPE_OK: publish, by a's state; the caller then starts its windows anew where that is TAKEN, OTHER or
/// FAILED, since those open are of two bodies. IPE_NOT_READY: nothing new.
ipe_status_t ipe_announcement_push(ipe_announcement_t* a, ipe_estimator_t* e, const ipe_config_t* config, int64_t t_ns,
                                   const ipe_motion_t* motion, const ipe_wrench_t* wrench);

/// After ipe_announcement_push() gave IPE_OK: begin to publish, while in contact the body as the announced payload has moved it,
/// else as the filter has it.
void ipe_announcement_begin_publication(const ipe_announcement_t* a, const ipe_estimator_t* e,
                                        const ipe_config_t* config, ipe_publication_t* publication);

#endif
