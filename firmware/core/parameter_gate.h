// SPDX-License-Identifier: Apache-2.0
/// Inertial parameters for a control loop: what the estimates say, once they can be trusted, and never with a jump.
///
/// One thread offers every estimate that arrives, the control thread reads at its own rate. An estimate is taken when it
/// is newer than the last one, young enough, judged good enough, observable, sharp enough, a body that can exist, and no
/// contradiction to the last one that was taken. Each refusal has a reason.
///
///   start                        nominal parameters; live ones after n_return acceptable estimates in a row
///   a new estimate is taken      theta moves to it within transition_time, along bodies that can exist; one that only
///                                refines where theta is moving to does not delay it
///   the daemon began again       theta stays; live ones after n_return acceptable estimates in a row
///   none is taken for age_max    the fall-back: nominal parameters, or the last good ones, as chosen; then as at start
///   a payload change announced   the parameters in use are wrong from there on, and the fall-back is no longer the nominal
///                                body: that one is gone, whether the gate was told of the change or began after it; the
///                                last good ones stay (a fall-back that has begun goes on to the nominal parameters). Taken is the first estimate that
///                                agrees with the one of the window before it. Until all its parameters are sharp again
///                                only the mass must be, and as long as the inertia about the CoG is not, that of the
///                                parameters in use is kept
///   an announced payload         (COMMAND EXPECT) comes into contact: estimates are provisional, all their parameters stay sharp,
///                                the verdict is care. Each is taken at once, as is the first one after them, and theta
///                                follows within change_time
///
/// theta(t) = (1 - x) theta_0 + x theta_1, x from 0 to 1: the pseudo-inertia is linear in theta, and positive definite
/// matrices are a convex set, so every body on the way can exist when both ends can. Mass, CoG and inertia change together.
///
/// 1.5 KB of state, no heap, no system calls. One thread may offer, one other may read; read() is wait-free (a triple
/// buffer: it never waits for the writer, nor the writer for it). Times are those of ESTIMATE's t_ns: host time, ns.
/// Source of the pseudo-inertia: Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018; see firmware/DESIGN.md, "Control loop".
#ifndef IPE_PARAMETER_GATE_H
#define IPE_PARAMETER_GATE_H

#include "body.h"
#include "types.h"

/// Why an estimate was not taken; IPE_GATE_TAKEN: it was.
typedef enum {
    IPE_GATE_TAKEN = 0,
    IPE_GATE_WAITS,          ///< acceptable, but fewer than n_return in a row so far, or a change is not over yet
    IPE_GATE_NOT_FINITE,     ///< a number, or a sigma that follows from the covariance, is NaN or Inf
    IPE_GATE_OLD_SEQUENCE,   ///< not newer than the last one that was offered
    IPE_GATE_TOO_OLD,        ///< its t_ns is more than age_max ago, or ahead of now
    IPE_GATE_VERDICT,        ///< worse than verdict_max
    IPE_GATE_UNOBSERVABLE,   ///< one of the ten parameters
    IPE_GATE_SIGMA,          ///< a standard deviation is over its limit
    IPE_GATE_INCONSISTENT,   ///< no body that can exist
    IPE_GATE_CONTRADICTION,  ///< further from the last one taken than step_sigmas, and no change of payload explains it
    IPE_GATE_REASONS
} ipe_gate_reason_t;

typedef enum {
    IPE_GATE_NOMINAL = 0,      ///< nominal parameters
    IPE_GATE_LIVE = 1,         ///< an estimate's
    IPE_GATE_LAST_GOOD = 2,    ///< an estimate's that is older than age_max
    IPE_GATE_FALLING_BACK = 3  ///< between an estimate's and the nominal ones
} ipe_gate_source_t;

/// What is demanded of an estimate. ipe_parameter_gate_default() gives values for a start.
typedef struct {
    double mass_std;         ///< largest, as a share of the mass
    double cog_std;          ///< largest of its three, m
    double inertia_std;      ///< largest of its six, of a third of the inertia's trace about C
    int verdict_max;         ///< of ESTIMATE: 1 good, 2 care; after an announced change 2
    double age_max;          ///< s
    double transition_time;  ///< s
    double change_time;      ///< s, the same while estimates are provisional, and of the first one after them
    double step_sigmas;      ///< of the difference of two estimates between which no payload changed
    int n_return;            ///< acceptable estimates in a row before the first one is taken
    bool keep_last_good;     ///< the fall-back; false: nominal parameters
} ipe_gate_limits_t;

/// An estimate: the fields of ESTIMATE of the same names.
typedef struct {
    int64_t sequence, t_ns, n_changes;
    double theta[IPE_NP];               ///< m, h = m cog, J about P, P axes; kg, kg m, kg m2
    double covariance[IPE_NP][IPE_NP];  ///< of theta
    bool observable[IPE_NP];
    int verdict;
    bool is_provisional;  ///< `provisional`: an announced payload is coming into contact
} ipe_gate_estimate_t;

/// What the control loop uses.
typedef struct {
    double theta[IPE_NP];  ///< as in ipe_gate_estimate_t; always a body that can exist
    ipe_gate_source_t source;
    int64_t sequence;      ///< of the estimate that theta is or moves to; -1: none
    double age;            ///< s since the last estimate was taken; -1: none was
    bool is_moving;        ///< theta is on its way between two bodies
} ipe_gate_parameters_t;

/// A transition and what follows it: the same at both ends of the buffer. Private.
typedef struct {
    double from[IPE_NP], to[IPE_NP];
    int64_t begin_ns, sequence;
    double time;  ///< s, of the transition
    bool has_estimate;
    bool keeps;   ///< the fall-back is this estimate
} ipe_gate_segment_t;

typedef struct {
    ipe_gate_limits_t limits;
    double nominal[IPE_NP];

    ipe_gate_segment_t slot[3];  ///< one is written, one is read, one is between them
    unsigned char middle;        ///< its number, and 4: it is new
    unsigned char writing, reading;

    ipe_gate_segment_t now;   ///< the writer's copy
    ipe_body_t last;          ///< taken
    int64_t known_n_changes;  ///< payload changes that the parameters in use contain; -1: nothing was offered yet
    bool is_changed;          ///< a change was announced since the last one whose parameters were all sharp
    bool is_in_contact;       ///< the last one taken was provisional
    bool was_changed;         ///< one was announced: the nominal body is no longer there
    ipe_body_t previous;      ///< acceptable, of the window before
    int64_t previous_t_ns, previous_n_changes;
    int64_t last_sequence, last_t_ns;  ///< offered
    bool is_returning;                 ///< the daemon began again: n_return in a row are needed
    int n_in_a_row;                    ///< acceptable ones,
    int64_t acceptable_ns;             ///< the newest of them at this time
    uint64_t n[IPE_GATE_REASONS];      ///< estimates by what became of them
} ipe_parameter_gate_t;

/// Limits for a start: mass to 2 %, CoG to 20 mm, inertia to 20 %, verdict good, age 1 s, transition 0.5 s, during an announced contact 0.02 s, 6 sigmas,
/// 5 estimates in a row, fall-back nominal.
ipe_gate_limits_t ipe_parameter_gate_default(void);

/// Begin with nominal parameters.
///
///   nominal  theta about P, P axes
///
/// IPE_OK; IPE_ERR_RANGE: a limit is not positive (transition_time and change_time may be 0), or nominal is no body that can exist; the
/// gate must not be used then.
ipe_status_t ipe_parameter_gate_init(ipe_parameter_gate_t* g, const ipe_gate_limits_t* limits,
                                     const double nominal[IPE_NP]);

/// Offer an estimate at host time now_ns. Only one thread. What became of it; 1 us.
ipe_gate_reason_t ipe_parameter_gate_offer(ipe_parameter_gate_t* g, const ipe_gate_estimate_t* estimate,
                                           int64_t now_ns);

/// The parameters at host time now_ns. Only one thread, which may be another one than the writer's. 0.1 us.
void ipe_parameter_gate_read(ipe_parameter_gate_t* g, int64_t now_ns, ipe_gate_parameters_t* parameters);

/// A reason in words, such as "a standard deviation is over its limit". Needs no freeing.
const char* ipe_parameter_gate_text(ipe_gate_reason_t reason);

#endif
